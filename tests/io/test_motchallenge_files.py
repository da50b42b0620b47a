"""Files of MOTChallenge as they are found: seqinfo.ini or none, scores, repairs, frames."""

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mixer_torch.datasets import MOTChallenge
from mixer_torch.datasets.calibration import read_calibration
from mixer_torch.io.motchallenge import (
    SequenceInfo,
    as_confidence,
    read_repaired,
    read_seqinfo,
)

INFO = SequenceInfo(10, width=100, height=80)


def write_detections(folder, text):
    (folder / "det").mkdir(exist_ok=True)
    (folder / "det" / "det.txt").write_text(text)
    return folder / "det" / "det.txt"


def write_image(file, value):
    file.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(file), np.full((40, 60, 3), value, np.uint8))


def test_seqinfo_says_what_it_knows(tmp_path):
    file = tmp_path / "seqinfo.ini"
    file.write_text("[Sequence]\nframeRate=25\nseqLength=12\nimWidth=64.0\nimHeight=-1\nimExt=.png")
    assert read_seqinfo(file) == SequenceInfo(25, "img1", ".png", 12, 64, None)
    assert read_seqinfo(file, 5).frame_rate == 25
    file.write_text("[Sequence]\nimDir=frames")
    assert read_seqinfo(file, 5) == SequenceInfo(5, "frames")
    file.write_text("[Sequence]\nframeRate=25\nseqLength=many")
    with pytest.raises(ValueError, match=r"seqinfo\.ini: seqLength: expected a number, got 'many'"):
        read_seqinfo(file)


def test_without_seqinfo_a_frame_rate_is_enough(tmp_path):
    write_detections(tmp_path, "1,-1,1,2,3,4,0.5\n6,-1,1,2,3,4,0.5\n")
    with pytest.raises(FileNotFoundError, match=r"seqinfo\.ini .* write it, .* or set frame_rate"):
        MOTChallenge(tmp_path).load()
    assert MOTChallenge(tmp_path, frame_rate=5).load()["time"].tolist() == [0, 1]
    for wrong in (0.0, -3.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="frame_rate: expected a positive number"):
            MOTChallenge(tmp_path, frame_rate=wrong)


def test_without_seqinfo_frames_are_found_by_the_numbers_in_their_names(tmp_path):
    write_detections(tmp_path, "3,-1,1,2,3,4,0.5\n")
    for k in (2, 3, 4):
        write_image(tmp_path / "img1" / f"{k:08d}.png", 10 * k)
    write_image(tmp_path / "img1" / "thumbnail.png", 0)
    dataset = MOTChallenge(tmp_path, frame_rate=5)
    assert dataset.load().images.frame(0)[0, 0, 0] == 30
    frames = dataset.frames()
    assert frames.number.tolist() == [2, 3, 4]
    assert [frames.frames[k][0, 0, 0] for k in frames.place] == [20, 30, 40]
    assert MOTChallenge(tmp_path, frame_rate=5, stop=3, start=3).frames().number.tolist() == [3]
    assert frames.places(np.array([4, 2])).tolist() == [2, 0]
    assert frames.places(np.array([4, 5])) is None


def test_of_a_folder_and_a_video_the_one_with_more_frames_is_shown(tmp_path):
    write_detections(tmp_path, "1,-1,1,2,3,4,0.5\n")
    assert MOTChallenge(tmp_path, frame_rate=5).frames() is None
    write_image(tmp_path / "img1" / "000001.jpg", 200)
    (tmp_path / "video").mkdir()
    file = str(tmp_path / "video" / "all.avi")
    writer = cv2.VideoWriter(file, cv2.VideoWriter_fourcc(*"MJPG"), 10, (60, 40))
    for k in range(4):
        writer.write(np.full((40, 60, 3), 40 * k, np.uint8))
    writer.release()
    dataset = MOTChallenge(tmp_path, frame_rate=5, step=2)
    assert dataset.frames().number.tolist() == [1, 3]
    assert dataset.frames().place.tolist() == [0, 2]
    assert dataset.load().images.frame(0)[0, 0, 0] == pytest.approx(200, abs=3)


def test_truth_is_read_where_it_is_asked_for(tmp_path):
    write_detections(tmp_path, "1,-1,1,2,3,4,0.5\n")
    (tmp_path / "gt").mkdir()
    (tmp_path / "gt" / "gt.txt").write_text("1,7,1,2,3,4,1\n")
    assert MOTChallenge(tmp_path, frame_rate=5).load()["identity"].tolist() == [7]
    assert "identity" not in MOTChallenge(tmp_path, frame_rate=5, truth=False).load().features


@pytest.mark.parametrize("scores", [[0.2, 0.0, 1.0], [1.0, 1.0], [0.5], []])
def test_scores_that_are_probabilities_stay(scores):
    score = np.array(scores, dtype=float)
    assert as_confidence(score).tolist() == scores


@given(
    st.lists(st.integers(-1000, 1000), min_size=2, max_size=50),
    st.sampled_from([0.01, 1.0, 30.0]),
)
@settings(max_examples=60, deadline=None)
def test_other_scores_become_so_and_keep_their_order(whole, scale):
    score = np.array(whole) * scale / 100
    assume(score.min() < 0 or score.max() > 1)
    confidence = as_confidence(score)
    assert ((confidence >= 0) & (confidence <= 1)).all()
    order = np.argsort(score, kind="stable")
    assert (np.diff(confidence[order]) >= 0).all()
    if score.min() == score.max():
        assert (confidence == 1).all()


@pytest.mark.parametrize(("scale", "shift"), [(1, -1), (0.3, -2), (100, 0)])
def test_other_scores_are_spread_as_those_of_networks(scale, shift):
    """Whatever the scale of scores: that is why thresholds mean the same."""
    score = np.random.default_rng(0).gamma(2, 1, 2001)
    confidence = as_confidence(scale * score + shift)
    assert np.quantile(confidence, 0.1) == pytest.approx(0.8, abs=1e-3)
    assert np.median(confidence) == pytest.approx(0.98, abs=1e-3)


def test_scores_of_a_detector_that_is_seldom_sure_are_spread_where_that_is_asked_for():
    score = np.random.default_rng(0).beta(5, 2, 2001)  # a median of 0.73
    assert (as_confidence(score) == score).all()
    confidence = as_confidence(score, spread=True)
    assert np.quantile(confidence, 0.1) == pytest.approx(0.8, abs=1e-3)
    assert np.median(confidence) == pytest.approx(0.98, abs=1e-3)
    sure = 0.9 + score / 10
    assert (as_confidence(sure, spread=True) == sure).all()


def test_a_file_that_says_minus_one_for_no_score_is_sure(tmp_path):
    write_detections(tmp_path, "1,-1,1,2,3,4,-1\n2,-1,1,2,3,4,-1\n")
    seen = MOTChallenge(tmp_path, frame_rate=5).load()
    assert seen["confidence"].tolist() == [1, 1]


def test_min_confidence_is_a_score_of_the_file(tmp_path):
    write_detections(tmp_path, "1,-1,1,2,3,4,-0.5\n1,-1,11,2,3,4,0.5\n2,-1,1,2,3,4,2.5\n")
    every = MOTChallenge(tmp_path, frame_rate=5).load()["confidence"]
    some = MOTChallenge(tmp_path, frame_rate=5, min_confidence=0.0).load()
    assert some["confidence"].tolist() == every[1:].tolist()


def test_repair_counts_what_it_leaves_out_and_warns_of_it(tmp_path):
    file = write_detections(
        tmp_path,
        "2,-1,10,10,20,20,0.5\n"
        "1,-1,10,10,0,20,0.5\n"
        "1,-1,10,10,20,-2,0.5\n"
        "1,-1,10,10,20,20,0.4\n"
        "1,-1,10,10,20,20,0.8\n"
        "1,-1,nan,10,20,20,0.8\n"
        "1,-1,150,10,20,20,0.8\n"
        "9,-1,10,10,20,20,0.8\n",
    )
    rows, notes = read_repaired(file, INFO, 5)
    assert rows[:, [0, 6]].tolist() == [[1, 0.8], [2, 0.5]]
    assert [note.partition("det.txt: ")[2] for note in notes] == [
        "1 left out, a number is not finite; first in line 6",
        "2 left out, width or height is not positive; first in line 2",
        "1 left out, outside of the image of 100 x 80; first in line 7",
        "1 left out, after frame 5, the last by seqinfo.ini; first in line 8",
        "1 left out, the same box is in this frame already; first in line 4",
    ]
    write_detections(tmp_path, "1,-1,10,10,0,20,0.5\n1,-1,10,10,20,20,0.5\n")
    with pytest.warns(UserWarning, match="1 left out, width or height"):
        assert len(MOTChallenge(tmp_path, frame_rate=5, repair=True).load()) == 1
    with pytest.raises(ValueError, match="line 1: expected a positive width"):
        MOTChallenge(tmp_path, frame_rate=5).load()


@given(st.permutations(range(8)))
@settings(max_examples=25, deadline=None)
def test_what_repair_leaves_does_not_depend_on_the_order(tmp_path_factory, order):
    lines = [
        f"{f},-1,{x},10,20,20,{s}"
        for f in (1, 2)
        for x, s in ((1, 0.5), (1, 0.6), (5, 0.6), (9, 0.9))
    ]
    folder = tmp_path_factory.mktemp("order")
    file = write_detections(folder, "\n".join(lines[k] for k in order))
    rows = read_repaired(file, INFO)[0]
    expected = [[f, x, s] for f in (1, 2) for x, s in ((9, 0.9), (1, 0.6), (5, 0.6))]
    assert rows[:, [0, 2, 6]].tolist() == expected


def test_a_long_table_is_repaired(tmp_path):
    count = 50_000
    frame = np.arange(count) // 50 + 1
    left = np.arange(count) % 50 * 20
    rows = np.column_stack([frame, -np.ones(count), left, *np.full((3, count), 10), left / 1000])
    np.savetxt(tmp_path / "det.txt", rows, fmt="%g", delimiter=",")
    assert len(read_repaired(tmp_path / "det.txt", SequenceInfo(10))[0]) == count


@pytest.mark.parametrize("repair", [False, True])
def test_a_file_that_is_no_text_is_named(tmp_path, repair):
    file = write_detections(tmp_path, "")
    file.write_bytes(b"1,-1,1,2,3,4,\xff\xfe\n")
    with pytest.raises(ValueError, match=r"det\.txt is not readable as text"):
        MOTChallenge(tmp_path, frame_rate=5, repair=repair).load()
    (tmp_path / "seqinfo.ini").write_bytes(b"[Sequence]\nname=caf\xe9\nframeRate=25\n")
    assert read_seqinfo(tmp_path / "seqinfo.ini").frame_rate == 25


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"det\.txt does not exist"):
        MOTChallenge(tmp_path, frame_rate=5, repair=True).load()


def test_a_folder_is_not_said_to_be_missing(tmp_path):
    (tmp_path / "det" / "det.txt").mkdir(parents=True)
    with pytest.raises(IsADirectoryError, match=r"det\.txt is a folder, expected a file"):
        MOTChallenge(tmp_path, frame_rate=5).load()
    with pytest.raises(IsADirectoryError, match=r"calibration .* is a folder, expected a file"):
        read_calibration(tmp_path)
