"""`mixer evaluate` of tracks: which file is measured against which, and what is said of it."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from mixer_torch.io.results import write_associations
from mixer_torch.io.tracks import write_tracks
from mixer_torch.metrics.tracking import evaluate_sequences
from mixer_torch.observations import Observations
from mixer_torch.tracking import Tracks

SEQINFO = "[Sequence]\nframeRate=10\nseqLength={length}\n"


@pytest.fixture
def evaluate(mixer):
    """Run `mixer evaluate` in an empty folder: (exit code, standard output, standard error)."""
    return lambda *argv: mixer("evaluate", *argv)


def measured(evaluate, *argv):
    """What is in the file of metrics."""
    code, out, err = evaluate(*argv, "--out", "m.json")
    assert code == 0, err
    assert "written: m.json" in out
    return json.loads(Path("m.json").read_text())


def walk(frames=6, objects=3, first=1):
    """Objects side by side, who walk to the right."""
    frame, identity = (grid.ravel() for grid in np.mgrid[first : first + frames, 1 : objects + 1])
    left, top = 5.0 * frame, 50.0 * identity
    return Tracks(frame, identity, np.stack([left, top, left + 20, top + 40], 1))


def write_sequence(folder, tracks, ignored=(), length=6):
    """A sequence with its truth; rows of flag 0 as they are given."""
    folder = Path(folder)
    (folder / "gt").mkdir(parents=True)
    rows = [
        f"{frame},{identity},{x1},{y1},{x2 - x1},{y2 - y1},1,-1,-1,-1"
        for frame, identity, (x1, y1, x2, y2) in zip(
            tracks.frame, tracks.identity, tracks.box, strict=True
        )
    ]
    (folder / "gt" / "gt.txt").write_text("\n".join([*rows, *ignored]) + "\n")
    (folder / "seqinfo.ini").write_text(SEQINFO.format(length=length))


def mistaken(tracks):
    """One object lost and found under another name, and one box of clutter."""
    identity = np.where((tracks.identity == 2) & (tracks.frame > 3), 9, tracks.identity)
    box = np.append(tracks.box, [[900, 900, 920, 940]], axis=0)
    return Tracks(np.append(tracks.frame, 1), np.append(identity, 30), box)


@pytest.fixture
def scene(evaluate):
    """Two sequences in data/, and results of them in out/."""
    Path("out").mkdir()
    results = {"east": mistaken(walk()), "west": walk(objects=2)}
    truths = {"east": walk(), "west": walk(objects=2)}
    for name, truth in truths.items():
        write_sequence(f"data/{name}", truth, ["2,77,500,500,5,5,0,-1,-1,-1"])
        write_tracks(f"out/{name}.txt", results[name])
    return evaluate_sequences(results, truths)


def assert_equal(metrics, expected):
    assert metrics["combined"] == pytest.approx(expected["combined"])
    assert list(metrics["sequences"]) == list(expected["sequences"])
    for name, values in expected["sequences"].items():
        assert metrics["sequences"][name] == pytest.approx(values)


def test_a_folder_of_results_beside_a_folder_of_sequences(evaluate, scene):
    Path("out/config.yaml").write_text("")
    Path("out/east.mp4").write_text("")
    assert_equal(measured(evaluate, "out", "--truth", "data"), scene)
    code, out, err = evaluate("out", "--truth", "data")
    assert (code, err) == (0, "")
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines() if line}
    assert list(rows)[:4] == ["sequence", "east", "west", "combined"]
    assert " ".join(rows["sequence"]) == (
        "HOTA AssA DetA IDF1 MOTA ID switches FP FN pairwise F1 B-cubed F1"
    )
    assert rows["west"] == ["100.0"] * 5 + ["0"] * 3 + ["100.0"] * 2
    assert rows["east"][5:8] == rows["combined"][5:8] == ["1", "1", "0"]
    assert rows["east"][4] == f"{100 * (18 - 2) / 18:.1f}"


def one_only(scene, name):
    return {"combined": scene["sequences"][name], "sequences": {name: scene["sequences"][name]}}


@pytest.mark.parametrize(
    "argv",
    [
        ("out/east.txt", "--truth", "data/east"),
        ("out/east.txt", "--truth", "data/east/"),
        ("out/east.txt", "--truth", "data/east/gt/gt.txt"),
        ("out/east.txt", "--truth", "data"),
        ("out", "--truth", "data/east"),
        ("--truth", "data/east", "out/east.txt"),
        ("--result", "out/east.txt", "--truth", "data/east"),
        ("--result=out/east.txt", "--truth=data/east"),
    ],
)
def test_one_sequence_however_it_is_named(evaluate, scene, argv):
    assert_equal(measured(evaluate, *argv), one_only(scene, "east"))
    assert "combined" not in evaluate(*argv)[1].replace("written", "")


@pytest.mark.parametrize("suffix", [".txt", ".json", ".csv", ".parquet"])
def test_results_and_truths_in_all_formats(evaluate, scene, suffix):
    write_tracks(f"found{suffix}", mistaken(walk()))
    metrics = measured(evaluate, f"found{suffix}", "--truth", "data/east")
    assert metrics["sequences"]["east"] == pytest.approx(scene["sequences"]["east"])
    write_tracks(f"truth{suffix}", walk())
    metrics = measured(evaluate, f"found{suffix}", "--truth", f"truth{suffix}")
    assert metrics["sequences"]["truth"] == pytest.approx(scene["sequences"]["east"])


def test_a_folder_in_another_format_than_text(evaluate, scene):
    Path("tables").mkdir()
    write_tracks("tables/east.parquet", mistaken(walk()))
    write_tracks("tables/west.parquet", walk(objects=2))
    Path("tables/metrics.json").write_text("{}")
    assert_equal(measured(evaluate, "tables", "--truth", "data"), scene)


def test_what_associate_writes_is_a_result(evaluate, scene):
    tracks = mistaken(walk())
    Path("associated").mkdir()
    write_tracks("associated/tracks.txt", tracks)
    observations = Observations(
        torch.from_numpy(tracks.frame),
        {"frame": torch.from_numpy(tracks.frame), "box": torch.from_numpy(tracks.box)},
    )
    labels = torch.from_numpy(tracks.identity - 1)
    write_associations(Path("associated/associations.csv"), observations, labels)
    for result in ("associated", "associated/tracks.txt", "associated/associations.csv"):
        metrics = measured(evaluate, result, "--truth", "data/east")
        assert metrics["sequences"]["east"] == pytest.approx(scene["sequences"]["east"])


def test_the_truth_of_a_dataset_in_the_frames_that_it_chooses(evaluate, scene):
    dataset = {
        "class_path": "mixer_torch.datasets.MOTChallenge",
        "init_args": {"path": "data/east", "start": 2, "step": 2},
    }
    Path("c.yaml").write_text(yaml.safe_dump({"dataset": dataset, "scorers": []}))
    metrics = measured(evaluate, "out/east.txt", "--config", "c.yaml")
    assert metrics["sequences"]["east"]["TP"] == 9
    assert metrics["sequences"]["east"]["FP"] == metrics["sequences"]["east"]["FN"] == 0
    assert metrics["sequences"]["east"]["IDSW"] == 1


def test_the_truth_of_a_dataset_that_is_no_sequence(evaluate, scene):
    rows = ["frame,identity,x1,y1,x2,y2", "1,0,5,50,25,90", "1,-1,500,0,510,10", "2,0,10,50,30,90"]
    Path("seen.csv").write_text("\n".join(rows) + "\n")
    argv = ("--dataset", "mixer_torch.datasets.Table", "--dataset.path", "seen.csv")
    write_tracks("found.txt", walk(2, 1))
    assert measured(evaluate, "found.txt", *argv)["combined"]["HOTA"] == pytest.approx(100)
    # Without a column of labels, a table of identities is tracks, too.
    write_tracks("found.csv", walk(2, 1))
    assert measured(evaluate, "found.csv", *argv)["combined"]["HOTA"] == pytest.approx(100)
    Path("seen.csv").write_text("frame,x1,y1,x2,y2\n1,5,50,25,90\n")
    code, _, err = evaluate("found.txt", *argv)
    assert code == 2
    assert "expected known identities" in err


def test_classes_and_distractors_of_later_benchmarks(evaluate):
    lines = [f"{frame},{k},{100 * k},0,20,20,1,{k},1" for frame in (1, 2) for k in (1, 2, 3)]
    write_sequence("MOT17-09", Tracks([], [], []), lines)
    found = Tracks(
        [1, 1, 1, 2, 2, 2], [1, 2, 3] * 2, [[100 * k, 0, 100 * k + 20, 20] for k in (1, 2, 3)] * 2
    )
    write_tracks("found.txt", found)
    metrics = measured(evaluate, "found.txt", "--truth", "MOT17-09")["combined"]
    assert (metrics["TP"], metrics["FP"], metrics["FN"]) == (2, 2, 0)
    metrics = measured(evaluate, "found.txt", "--truth", "MOT17-09", "--classes", "[1,3]")[
        "combined"
    ]
    assert (metrics["TP"], metrics["FP"], metrics["FN"]) == (4, 0, 0)


def test_how_much_has_to_overlap(evaluate):
    write_sequence("a", Tracks([1], [1], [[0, 0, 10, 10]]))
    write_tracks("a.txt", Tracks([1], [1], [[4, 0, 14, 10]]))
    assert measured(evaluate, "a.txt", "--truth", "a")["combined"]["TP"] == 0
    found = measured(evaluate, "a.txt", "--truth", "a", "--min_overlap", "0.4")
    assert found["combined"]["TP"] == 1


def test_nothing_found_is_a_result(evaluate, scene):
    Path("out/west.txt").write_text("")
    metrics = measured(evaluate, "out", "--truth", "data")
    assert metrics["sequences"]["west"]["FN"] == 12
    assert metrics["sequences"]["west"]["HOTA"] == 0


def write(path, text):
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize(
    ("prepare", "argv", "named"),
    [
        (lambda: Path("out/west.txt").unlink(), ("out", "--truth", "data"), "west.txt"),
        (lambda: write("out/north.txt", ""), ("out", "--truth", "data"), "north.txt"),
        (lambda: write("north.txt", ""), ("north.txt", "--truth", "data"), "east, west"),
        (lambda: None, ("none", "--truth", "data"), "result: none does not exist"),
        (lambda: None, ("out", "--truth", "none"), "none: not found"),
        (lambda: None, ("out", "--truth", "out"), "gt.txt, or sequences"),
        (lambda: None, ("out",), "expected --truth, or a dataset"),
        (lambda: None, ("out", "--truth", "data", "--min_overlap", "2"), "min_overlap"),
        (lambda: None, ("out", "--truth", "data", "--out", "m.txt"), "m.txt"),
        (lambda: None, ("--truth", "data"), "result"),
        (lambda: Path("empty").mkdir(), ("empty", "--truth", "data/east"), "empty/east.txt or"),
        (lambda: write("a.xml", ""), ("a.xml", "--truth", "data/east"), "a.xml"),
        (
            lambda: write("out/east.txt", "1,1,0,0,5,5\n1,1,1,1,5,5\n"),
            ("out", "--truth", "data"),
            "out/east.txt, line 2: this identity",
        ),
        (
            lambda: write("data/east/gt/gt.txt", "1,1,0,0,5,5,1\n1,1,0,0,5\n"),
            ("out", "--truth", "data"),
            "gt.txt, line 2: expected 7 numbers, got 5",
        ),
        (
            lambda: write("out/east.txt", "7,1,0,0,5,5\n"),
            ("out", "--truth", "data"),
            "out/east.txt: expected frames 1 to 6, as seqinfo.ini of the truth says, got 7",
        ),
        (lambda: write("r.csv", "frame,x1\n1,2\n"), ("r.csv", "--truth", "data/east"), "identity"),
    ],
)
def test_mistakes_are_named(evaluate, scene, prepare, argv, named):
    prepare()
    code, out, err = evaluate(*argv)
    assert (code, out) == (2, "")
    assert re.search(re.escape(named), err), err
    assert "Traceback" not in err
    assert not Path("m.json").exists()


@pytest.mark.real_data
def test_the_truth_of_a_real_sequence_finds_all_of_it(evaluate, real_data):
    found = measured(evaluate, real_data / "mot15/KITTI-17/gt/gt.txt", "--truth", "mot15/KITTI-17")
    assert found["combined"]["FN"] == found["combined"]["IDSW"] == 0
    assert found["combined"]["FP"] > 0  # regions to ignore are no persons
    assert found["combined"]["TP"] == 683
