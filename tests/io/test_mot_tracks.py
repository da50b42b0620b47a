import re

import numpy as np
import pytest
from drawn_tracks import assert_same, drawn_tracks
from hypothesis import given

from mixer_torch.io.tracks import read_mot, read_mot_truth, write_mot
from mixer_torch.metrics.tracking import evaluate_tracks
from mixer_torch.tracking import Tracks


def file_of(folder, text, name="result.txt"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


@given(drawn_tracks())
def test_what_is_written_is_read_to_the_hundredth_of_a_pixel(tmp_path_factory, columns):
    tracks = Tracks(**columns)
    path = tmp_path_factory.mktemp("mot") / "tracks.txt"
    write_mot(path, tracks)
    assert_same(read_mot(path), tracks, atol=0.0101, leave_out=("observation",))
    again = path.with_name("again.txt")
    write_mot(again, read_mot(path))
    assert again.read_text() == path.read_text()


def test_a_result_is_in_the_format_of_motchallenge(tmp_path):
    box = [[1, 2, 4, 6], [0.125, 0, 10, 20], [5, 5, 6, 6]]
    write_mot(tmp_path / "a.txt", Tracks([2, 1, 1], [1, 9, 3], box, [0.5, 1, np.nan]))
    assert (tmp_path / "a.txt").read_text() == (
        "1,3,5.00,5.00,1.00,1.00,-1,-1,-1,-1\n"
        "1,9,0.12,0.00,9.88,20.00,1,-1,-1,-1\n"
        "2,1,1.00,2.00,3.00,4.00,0.5,-1,-1,-1\n"
    )


@pytest.mark.parametrize(
    "text",
    [
        "1,2,10,20,30,40,0.5,-1,-1,-1\n3,7,0,0,5,5,1,-1,-1,-1\n",
        "1,2,10,20,30,40,0.5\n3,7,0,0,5,5,1",
        "1.0, 2.0, 10, 20, 30.0, 40, 0.5, -1, -1, -1, 17, 18\r\n\r\n3,7,0,0,5,5,1,1,1,0,0,0",
        "\n1 2 10 20 30 40 0.5\n3 7 0 0 5 5 1\n\n",
        "\ufeff3e0,7,0,0,5,5,1\n1,2,10,20,30,40,.5\n",
    ],
)
def test_files_of_other_people_are_read(tmp_path, text):
    tracks = read_mot(file_of(tmp_path, text))
    assert tracks.frame.tolist() == [1, 3]
    assert tracks.identity.tolist() == [2, 7]
    assert tracks.box.tolist() == [[10, 20, 40, 60], [0, 0, 5, 5]]
    assert tracks.confidence.tolist() == [0.5, 1]


def test_what_other_people_leave_out_or_begin_at_zero(tmp_path):
    tracks = read_mot(file_of(tmp_path, "0,0,1,1,2,2\n0,3,1,1,0,0\n"))
    assert tracks.identity.tolist() == [1, 4]
    assert tracks.confidence.tolist() == [1, 1]
    assert len(read_mot(file_of(tmp_path, ""))) == 0
    assert len(read_mot(file_of(tmp_path, "\n \n"))) == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,1,0,0,5,5\n1,x,0,0,5,5\n", "line 2: expected a number, got 'x'"),
        ("1,1,0,0,5,5,1\n\n2,1,0,0,5,5\n", "line 3: expected 7 numbers, got 6"),
        ("1,1,0,0,5\n", "line 1: expected at least 6 numbers, got 5"),
        ("1,1,0,0,5,nan,1\n", "line 1: a number is not finite"),
        ("1,1,0,0,5,5\n1.5,1,0,0,5,5\n", "line 2: expected a frame of 0 or more"),
        ("1,1.5,0,0,5,5\n", "line 1: expected an identity of 0 or more"),
        ("1,2,0,0,5,5\n1,-1,0,0,5,5\n", "line 2: expected an identity .* detection of no track"),
        ("2,1,0,0,5,5\n1,1,0,0,5,5\n2,1,3,0,5,5\n", "line 3: this identity is in this frame"),
    ],
)
def test_malformed_lines_are_named(tmp_path, text, message):
    path = file_of(tmp_path, text)
    with pytest.raises(ValueError, match=re.escape(str(path)) + f".*{message}"):
        read_mot(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.txt does not exist"):
        read_mot(tmp_path / "none.txt")


def test_cameras_that_the_format_cannot_hold_are_named(tmp_path):
    tracks = Tracks([1, 1], [1, 1], np.ones((2, 4)), camera=[3, 8])
    with pytest.raises(ValueError, match="expected one camera, got 3, 8"):
        write_mot(tmp_path / "a.txt", tracks)
    assert list(tmp_path.iterdir()) == []
    write_mot(tmp_path / "a.txt", tracks.select(tracks.camera == 8))


def test_an_interrupted_writer_leaves_what_was_there(tmp_path, monkeypatch):
    path = file_of(tmp_path, "old")
    tracks = Tracks([1, 2], [1, 1], np.ones((2, 4)))

    class Stop(BaseException):
        pass

    def interrupted(*columns, strict):
        yield next(zip(*columns, strict=strict))
        assert [file.name for file in tmp_path.iterdir() if file != path] == [".result.partial.txt"]
        raise Stop

    monkeypatch.setattr("mixer_torch.io.mot_tracks.zip", interrupted, raising=False)
    with pytest.raises(Stop):
        write_mot(path, tracks)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_truth_of_mot15_has_regions_to_ignore_and_no_classes(tmp_path):
    path = file_of(
        tmp_path, "1,1,0,0,5,5,1,2.5,3,-1\n1,2,9,9,5,5,0,-1,-1,-1\n2,1,0,0,5,5,1,2,3,-1\n"
    )
    truth = read_mot_truth(path)
    assert truth.tracks.frame.tolist() == [1, 2]
    assert truth.tracks.identity.tolist() == [1, 1]
    result = Tracks([1, 1], [1, 2], [[0, 0, 5, 5], [9, 9, 14, 14]])
    assert len(truth.without_distractors(result)) == 2
    assert evaluate_tracks(result, truth.tracks)["FP"] == 1


CLASSES = """\
1,1,0,0,10,10,1,1,1
1,2,100,0,10,10,0,8,1
1,3,200,0,10,10,0,1,1
1,4,300,0,10,10,1,3,1
1,5,400,0,10,10,0,6,1
1,6,500,0,10,10,1,1,1
1,7,500,3,10,10,0,12,1
2,1,0,0,10,10,1,1,1
"""
"""A pedestrian, a distractor, an ignored pedestrian, a car, a cart, and one before a reflection."""


def result_on(*left):
    left = np.array(left, dtype=float)
    return Tracks(
        np.ones(len(left), int),
        np.arange(1, len(left) + 1),
        np.stack([left, 0 * left, left + 10, 0 * left + 10], 1),
    )


def test_what_lies_on_a_distractor_is_neither_right_nor_wrong(tmp_path):
    truth = read_mot_truth(file_of(tmp_path, CLASSES, "MOT17-02/gt/gt.txt"))
    assert truth.tracks.identity.tolist() == [1, 6, 1]
    kept = truth.without_distractors(result_on(0, 100, 200, 300, 400, 500, 900))
    assert kept.box[:, 0].tolist() == [0, 200, 300, 400, 500, 900]
    metrics = evaluate_tracks(kept, truth.tracks)
    # Boxes on the ignored pedestrian, the car and the cart are wrong, as on MOTChallenge.
    assert (metrics["TP"], metrics["FP"], metrics["FN"]) == (2, 4, 1)


def test_a_distractor_takes_one_box_and_only_one_that_no_pedestrian_fits_better(tmp_path):
    truth = read_mot_truth(file_of(tmp_path, CLASSES, "MOT17-02/gt/gt.txt"))
    two = truth.without_distractors(result_on(100, 102))
    assert two.box[:, 0].tolist() == [102]
    far = truth.without_distractors(result_on(105))
    assert len(far) == 1
    other_frame = Tracks([2], [1], [[100, 0, 110, 10]])
    assert len(truth.without_distractors(other_frame)) == 1
    assert len(truth.without_distractors(Tracks([], [], []))) == 0


def test_carts_are_distractors_in_mot20_alone(tmp_path):
    truth = read_mot_truth(file_of(tmp_path, CLASSES, "MOT20-01/gt/gt.txt"))
    assert len(truth.without_distractors(result_on(400))) == 0
    path = file_of(tmp_path, CLASSES, "MOT16-02/gt/gt.txt")
    assert len(read_mot_truth(path).without_distractors(result_on(400))) == 1
    chosen = read_mot_truth(path, classes=(3,), distractors=(1,))
    assert chosen.tracks.identity.tolist() == [4]
    assert len(chosen.without_distractors(result_on(0, 300))) == 1


def with_trackeval(folder, name, result, benchmark):
    """HOTA, IDF1 and MOTA of a file as trackeval's own code reads, cleans and measures it."""
    datasets = pytest.importorskip("trackeval.datasets")
    metrics = pytest.importorskip("trackeval.metrics")
    place = folder / "trackers" / "ours" / "data"
    place.mkdir(parents=True)
    write_mot(place / f"{name}.txt", result)
    dataset = datasets.MotChallenge2DBox(
        {
            "GT_FOLDER": str(folder / "truth"),
            "TRACKERS_FOLDER": str(folder / "trackers"),
            "BENCHMARK": benchmark,
            "SKIP_SPLIT_FOL": True,
            "SEQ_INFO": {name: 6},
            "PRINT_CONFIG": False,
        }
    )
    data = dataset.get_preprocessed_seq_data(dataset.get_raw_seq_data("ours", name), "pedestrian")
    quiet = {"PRINT_CONFIG": False}
    clear = metrics.CLEAR(dict(quiet)).eval_sequence(data)
    return {
        "HOTA": 100 * metrics.HOTA().eval_sequence(data)["HOTA"].mean(),
        "IDF1": 100 * metrics.Identity(dict(quiet)).eval_sequence(data)["IDF1"],
        "MOTA": 100 * clear["MOTA"],
        "IDSW": clear["IDSW"],
        "FP": clear["CLR_FP"],
    }


@pytest.mark.parametrize("name", ["MOT17-02", "MOT20-01", "other"])
@pytest.mark.parametrize("seed", range(4))
def test_files_have_the_figures_that_trackeval_has_for_them(tmp_path, seed, name):
    random = np.random.default_rng(seed)
    lines, found = [], []
    for frame in range(1, 7):
        for identity in range(1, 9):
            left, top = 7 * identity + random.normal(), 3 * random.normal()
            kind, flag = (identity % 8) + 1, random.integers(0, 3) > 0
            kind = 1 if identity > 5 else kind
            if random.random() < 0.85:
                lines.append(f"{frame},{identity},{left:.2f},{top:.2f},10,20,{flag:d},{kind},1")
            if random.random() < 0.8:
                found.append((frame, random.choice(30), left + random.normal(), top))
    if name == "other":  # as MOT15 has it: ten columns, and no classes
        lines = [line + ",-1" for line in lines]
    path = file_of(tmp_path, "\n".join(lines), f"truth/{name}/gt/gt.txt")
    frame, identity, left, top = np.array(found).T.round(2)
    once = np.unique(np.stack([frame, identity]), axis=1, return_index=True)[1]
    box = np.stack([left, top, left + 10, top + 20], 1)[once]
    result = Tracks(frame[once].astype(int), identity[once].astype(int) + 1, box)
    truth = read_mot_truth(path)
    metrics = evaluate_tracks(truth.without_distractors(result), truth.tracks)
    benchmark = name[:5] if name != "other" else "MOT15"
    expected = with_trackeval(tmp_path, name, result, benchmark)
    assert {key: metrics[key] for key in expected} == pytest.approx(expected)
    assert 0 < metrics["HOTA"] < 100
