"""`mixer track`: what is written and said, for good input, bad input, and interrupted runs."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import yaml

from mixer_torch.association import Status
from mixer_torch.datasets import MOTChallenge
from mixer_torch.observations import VideoFrames
from mixer_torch.tracking.formats import read_tracks

# Objects of these sequences keep to lanes, 100 pixels wide: a label is a lane.
OWN_TRACKER = '''
import pathlib
import signal
import time

from mixer_torch.association import Association, Status, by_first_appearance
from mixer_torch.tracking.base import BaseTracker
from mixer_torch.tracking.tracks import Tracks

SEEN = []

class Lanes(BaseTracker):
    """Whoever keeps to a lane is one object.

    Args:
        width: Pixels.
        stop_at: Which call to be interrupted in.
        wait_at: Which call to wait in for longer than anyone does.
        latency: Seconds for each of 100 frames, but the last, which took ten times as long.
    """

    def __init__(
        self, width: float = 100, stop_at: int = 0, wait_at: int = 0, latency: float = 0
    ) -> None:
        self.width, self.stop_at, self.wait_at = width, stop_at, wait_at
        self.stats = {"latency": [latency] * 99 + [10 * latency]} if latency else {}

    def associate(self, observations, progress=None):
        SEEN.append(observations)
        if len(SEEN) == self.stop_at:
            signal.raise_signal(signal.SIGINT)
        if len(SEEN) == self.wait_at:
            pathlib.Path("waiting").touch()
            time.sleep(60)
        progress("lanes", 1, 1)
        lane = (observations["box"][:, 0] // self.width).long()
        return Association(by_first_appearance(lane), 0.0, Status.CONVERGED, None, self.stats)

    def finish(self, observations, association):
        return Tracks.from_labels(observations, association.labels)
'''
SEQINFO = "[Sequence]\nframeRate=10\nseqLength={length}\nimWidth=320\nimHeight=240\nimExt=.png\n"


@pytest.fixture
def track(mixer, monkeypatch):
    """Run `mixer track`: (exit code, standard output, standard error)."""
    monkeypatch.delenv("MIXER_DATA", raising=False)
    Path("own_tracker.py").write_text(OWN_TRACKER)
    write_config("lanes.yaml")

    def run(*argv, config="lanes.yaml"):
        return mixer("track", *argv, *(["--config", config] if config else []))

    yield run
    sys.modules.pop("own_tracker", None)


def write_config(path, **init_args):
    tracker = {"class_path": "own_tracker.Lanes", "init_args": init_args}
    Path(path).write_text(yaml.safe_dump({"tracker": tracker}))
    return path


def seen():
    """What the tracker was shown, by call."""
    return sys.modules["own_tracker"].SEEN


def lines(frames=range(1, 6), lanes=(0, 1), score=0.9):
    """One box a lane and frame, moving a pixel a frame."""
    return [
        f"{frame},-1,{100 * lane + 10 + frame},20,30,60,{score},-1,-1,-1"
        for frame in frames
        for lane in lanes
    ]


def write_sequence(folder, rows=None, truth=None, length=5, seqinfo=True):
    folder = Path(folder)
    (folder / "det").mkdir(parents=True)
    text = "\n".join(lines() if rows is None else rows)
    (folder / "det" / "det.txt").write_text(text + "\n")
    if truth is not None:
        (folder / "gt").mkdir()
        (folder / "gt" / "gt.txt").write_text("\n".join(truth) + "\n")
    if seqinfo:
        (folder / "seqinfo.ini").write_text(SEQINFO.format(length=length))
    return folder


def true_lines(frames=range(1, 6), lanes=(0, 1)):
    return [f"{f},{k + 7},{100 * k + 10 + f},20,30,60,1,-1,-1,-1" for f in frames for k in lanes]


def write_frames(folder, count):
    (Path(folder) / "img1").mkdir()
    for k in range(1, count + 1):
        cv2.imwrite(f"{folder}/img1/{k:06d}.png", np.full((240, 320, 3), 90, np.uint8))


def files_in(folder):
    return {path.name for path in Path(folder).iterdir()}


def text_of(name):
    return Path("out", f"{name}.txt").read_text()


def test_each_sequence_has_a_result_and_a_line(track):
    pytest.importorskip("trackeval")
    write_sequence("a/first", truth=true_lines())
    write_sequence("b/second", lines(range(1, 4), [0, 1, 2]), length=8)
    code, out, err = track("a/first", "b/second", "--out", "out")
    assert code == 0, err
    assert files_in("out") == {"first.txt", "second.txt", "config.yaml"}
    assert text_of("first").splitlines()[:3] == [
        "1,1,11.00,20.00,30.00,60.00,0.9,-1,-1,-1",
        "1,2,111.00,20.00,30.00,60.00,0.9,-1,-1,-1",
        "2,1,12.00,20.00,30.00,60.00,0.9,-1,-1,-1",
    ]
    table = [line.split() for line in out.splitlines()[:4]]
    metrics = ["HOTA", "AssA", "IDF1", "switches"]
    counts = ["frames", "detections", "tracks", "seconds", "frames/s"]
    assert table[0] == ["sequence", *counts, *metrics, "status"]
    assert table[1][:4] == ["first", "5", "10", "2"]
    assert table[1][6:] == ["100.0", "100.0", "100.0", "0", *Status.CONVERGED.value.split()]
    assert table[2][:4] == ["second", "8", "9", "3"]
    assert table[2][6:10] == ["-"] * 4
    assert table[3][:4] == ["all", "13", "19", "5"]
    assert table[3][6:] == ["100.0", "100.0", "100.0", "0"]
    config = yaml.safe_load(Path("out/config.yaml").read_text())
    assert config["tracker"]["class_path"] == "own_tracker.Lanes"
    assert track(config="out/config.yaml")[0] == 0


def test_the_truth_is_measured_with_and_never_shown(track):
    pytest.importorskip("trackeval")
    others = [line for line in true_lines() if not line.startswith(("4,8", "5,8"))]
    moved = [line.replace(",8,", ",9,") for line in true_lines([4, 5], [1])]
    write_sequence("walk", truth=[*others, *moved])
    code, out, err = track("walk", "--out", "out")
    assert code == 0, err
    assert "identity" not in seen()[0].features
    # Two boxes of ten are of a third object, which no track is of.
    assert out.splitlines()[1].split()[8] == "80.0"


def test_of_a_sequence_with_detections_alone_the_frame_rate_is_30_or_as_said(track):
    folder = write_sequence("bare", seqinfo=False)
    code, out, err = track(folder, "--out", "out")
    assert code == 0, err
    assert "note: bare: no seqinfo.ini, so 30 frames per second; see --frame_rate" in out
    assert seen()[0]["time"].max() == pytest.approx(4 / 30)
    code, out, err = track(folder, "--out", "out", "--frame_rate", 5)
    assert code == 0, err
    assert "note" not in out
    assert seen()[1]["time"].max() == pytest.approx(4 / 5)
    assert len(text_of("bare").splitlines()) == 10


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["here/walk", "there/walk"], "here/walk and there/walk are both called walk"),
        (["here/walk", "here/walk/."], "both called walk"),
        (["here/walk", "nowhere"], "nowhere: not found"),
        (["here/walk", "own_tracker.py"], "expected folders, got the file own_tracker.py"),
        (["here/walk", "here"], "here/det/det.txt does not exist"),
        (["here/walk", "broken"], "broken/det/det.txt, line 2: expected a number, got 'x'"),
        (["here/walk", "--out", "own_tracker.py"], "expected a folder, got the file own_tracker"),
        (["here/walk", "--device", "abacus"], "device: expected one that is here"),
        (["here/walk", "--frame_rate", "0"], "frame_rate: expected a positive number, got 0"),
        (["here/walk", "--step", "0"], "step: expected 1 or more"),
        (["here/walk", "--pixels", "true"], "000001.png does not exist"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_tracked(track, argv, message):
    write_sequence("here/walk")
    write_sequence("there/walk")
    write_sequence("broken", ["1,-1,11,20,30,60,0.9", "2,-1,x,20,30,60,0.9"])
    (Path("here") / "seqinfo.ini").write_text(SEQINFO.format(length=5))
    out = [] if "--out" in argv else ["--out", "out"]
    code, told, err = track(*argv, *out)
    assert (code, told) == (2, "")
    assert message in err
    assert len(err.splitlines()) == 1
    assert not Path("out").exists()
    assert not seen()


@pytest.mark.parametrize("argv", [[], ["walk", "--format", "pdf"], ["walk", "--tracker", "Gone"]])
def test_malformed_arguments(track, argv):
    write_sequence("walk")
    code, _, err = track(*argv, "--out", "out")
    assert code == 2
    assert err
    assert not Path("out").exists()


def test_without_a_tracker_there_is_none_to_run(track):
    write_sequence("walk")
    Path("none.yaml").write_text("tracker: null\n")
    code, _, err = track("walk", config="none.yaml")
    assert code == 2
    assert "configs/mot.yaml" in err


def result_of(track, rows, **other):
    """The result, what was said and the observations, of a sequence with these detections."""
    name = f"walk{len(list(Path('.').glob('walk*')))}"
    code, out, err = track(write_sequence(name, rows, **other), "--out", "out")
    assert code == 0, err
    assert files_in("out") >= {f"{name}.txt", "config.yaml"}
    return text_of(name), out, seen()[-1]


def test_a_tracker_that_works_online_says_how_long_frames_take(track):
    write_sequence("walk")
    online = write_config("online.yaml", latency=0.002)
    code, out, err = track("walk", "--out", "out", config=online)
    assert code == 0, err
    assert "walk: 2.0 ms a frame (median), 2.2 ms for 99 of 100, 20.0 ms at worst" in out


def test_lines_in_any_order_give_one_result(track):
    rows = [f"{line[:-12]}{0.5 + k / 40}" for k, line in enumerate(lines(lanes=(0, 1, 2)))]
    expected, out, _ = result_of(track, rows)
    assert "note" not in out
    for seed in range(3):
        shuffled = np.random.default_rng(seed).permutation(rows)
        assert result_of(track, shuffled)[:1] == (expected,)


def test_equal_boxes_are_one_detection_the_surest(track):
    expected = result_of(track, lines())[0]
    twice = [*lines(), *lines(range(2, 4), [1]), "4,-1,14,20,30,60,0.3,-1,-1,-1"]
    text, out, observations = result_of(track, twice)
    assert text == expected
    assert "3 left out, the same box is in this frame already; first in line 11" in out
    assert len(observations) == 10


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ("3,-1,210,20,0,60,0.9,-1,-1,-1", "width or height is not positive"),
        ("3,-1,210,20,30,-60,0.9,-1,-1,-1", "width or height is not positive"),
        ("3,-1,nan,20,30,60,0.9,-1,-1,-1", "a number is not finite"),
        ("3,-1,210,20,30,inf,0.9,-1,-1,-1", "a number is not finite"),
        ("3,-1,210,20,30,60,nan,-1,-1,-1", "a number is not finite"),
        ("3,-1,-40,20,30,60,0.9,-1,-1,-1", "outside of the image of 320 x 240"),
        ("3,-1,400,20,30,60,0.9,-1,-1,-1", "outside of the image of 320 x 240"),
        ("3,-1,210,300,30,60,0.9,-1,-1,-1", "outside of the image of 320 x 240"),
        ("6,-1,210,20,30,60,0.9,-1,-1,-1", "after frame 5, the last by seqinfo.ini"),
    ],
)
def test_a_box_that_is_of_no_use_is_left_out_and_told_of(track, bad, reason):
    expected = result_of(track, lines())[0]
    text, out, _ = result_of(track, [*lines()[:4], bad, *lines()[4:]])
    assert text == expected
    assert f"note: walk1/det/det.txt: 1 left out, {reason}; first in line 5" in out


def test_without_repair_a_bad_box_is_an_error(track):
    write_sequence("walk", [*lines(), "3,-1,210,20,0,60,0.9,-1,-1,-1"])
    code, _, err = track("walk", "--out", "out", "--repair", "false")
    assert code == 2
    assert "det.txt, line 11: expected a positive width and height" in err
    assert not Path("out").exists()


def test_boxes_partly_outside_of_the_image_are_kept_as_they_are(track):
    rows = [*lines(lanes=[1]), *(f"{f},-1,-15,-20,30,60,0.9" + ",-1" * 3 for f in range(1, 6))]
    text, out, _ = result_of(track, rows)
    assert "note" not in out
    assert "1,1,-15.00,-20.00,30.00,60.00,0.9,-1,-1,-1" in text.splitlines()


def test_frames_after_the_last_are_kept_where_stop_says_so(track):
    folder = write_sequence("long", lines(range(1, 9)), length=5)
    code, out, _ = track(folder, "--out", "out")
    assert code == 0
    assert "6 left out, after frame 5, the last by seqinfo.ini; first in line 11" in out
    assert text_of("long").splitlines()[-1].startswith("5,")
    code, out, _ = track(folder, "--out", "out", "--stop", 7)
    assert code == 0
    assert "note" not in out
    assert out.splitlines()[1].split()[:3] == ["long", "7", "14"]
    assert text_of("long").splitlines()[-1].startswith("7,")


def test_a_long_stretch_without_detections(track):
    rows = [*lines(range(1, 4)), *(f"200{line}" for line in lines(range(3, 6)))]
    text, out, _ = result_of(track, rows, length=2010)
    assert len(text.splitlines()) == 12
    assert out.splitlines()[1].split()[1:4] == ["2,010", "12", "2"]


@pytest.mark.parametrize("default", [False, True])
def test_no_detections_at_all(track, default):
    pytest.importorskip("trackeval")
    write_sequence("empty", [], truth=true_lines())
    code, out, err = track("empty", "--out", "out", config=None if default else "lanes.yaml")
    assert code == 0, err
    assert text_of("empty") == ""
    assert out.splitlines()[1].split()[:4] == ["empty", "5", "0", "0"]


@pytest.mark.parametrize(
    "row",
    [
        "{f},-1,{x},20,30,60",
        "{f},-1,{x},20,30,60,1",
        "{f}.0, -1, {x}, 20, 30, 60, 1, -1, -1, -1",
        "{f} -1 {x} 20 30 60 1 -1 -1 -1",
        "{f}.000e+00\t-1\t{x}\t20\t30\t60",
        "{f},-1,{x},20,30,60,-1,-1,-1,-1",
    ],
)
def test_columns_as_people_write_them(track, row):
    rows = [row.format(f=f, x=100 * k + 10 + f) for f in range(1, 6) for k in (0, 1)]
    assert result_of(track, rows)[0] == result_of(track, lines(score=1))[0]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0,-1,11,20,30,60,1", "line 3: expected a frame of 1 or more"),
        ("1.5,-1,11,20,30,60,1", "line 3: expected a frame of 1 or more"),
        ("nan,-1,11,20,30,60,1", "line 3: expected a frame of 1 or more"),
        ("1,-1,11,20,30,60", "line 3: expected 7 numbers, got 6"),
        ("1,-1,11,20,", "line 3: expected a number, got ''"),
    ],
)
def test_lines_that_cannot_be_understood_are_errors(track, row, message):
    rows = ["1,-1,11,20,30,60,1", "", row]
    code, _, err = track(write_sequence("walk", rows), "--out", "out")
    assert code == 2
    assert f"walk/det/det.txt, {message}" in err


def test_later_benchmarks_have_classes_and_scores_of_other_scales(track):
    pytest.importorskip("trackeval")
    rows = [
        f"{f},-1,{100 * k + 10 + f},20,30,60,{score},-1,-1,-1"
        for f in range(1, 6)
        for k, score in enumerate((1.7 + f / 10, -0.4, 0.8))
    ]
    truth = [
        f"{f},{k + 1},{100 * k + 10 + f},20,30,60,{int(kind == 1)},{kind},1"
        for f in range(1, 6)
        for k, kind in enumerate((1, 8, 3))
    ]
    folder = write_sequence("MOT17-02-DPM", rows, truth)
    code, out, err = track(folder, "--out", "out")
    assert code == 0, err
    confidence, lane = seen()[0]["confidence"], seen()[0]["box"][:, 0] // 100
    sure, clutter, car = (confidence[lane == k] for k in range(3))
    assert ((confidence > 0) & (confidence < 1)).all()
    assert sure.min() > car.max()
    assert car.min() > clutter.max()
    # The distractor (class 8) does not count; the car (class 3) was not to be found: 5 of 10.
    assert out.splitlines()[1].split()[8] == f"{100 * 2 * 5 / 15:.1f}"
    code, out, _ = track(folder, "--out", "out", "--min_confidence", "-0.1")
    assert code == 0
    assert len(seen()[1]) == 10
    code, out, _ = track(folder, "--out", "out", "--classes", "[1, 3]")
    assert code == 0


def test_parts_of_a_sequence(track):
    pytest.importorskip("trackeval")
    write_sequence("walk", truth=true_lines())
    code, out, _ = track("walk", "--out", "out", "--start", 2, "--stop", 4, "--step", 2)
    assert code == 0
    assert seen()[0]["frame"].tolist() == [2, 2, 4, 4]
    assert out.splitlines()[1].split()[1:4] == ["2", "4", "2"]
    assert out.splitlines()[1].split()[6] == "100.0"


def test_truth_that_cannot_be_read_is_no_obstacle(track):
    write_sequence("walk", truth=["1,1,10,20,30"])
    code, out, err = track("walk", "--out", "out")
    assert code == 0, err
    assert "note: walk: no metrics, as the truth is not readable: walk/gt/gt.txt, line 1" in out
    assert "HOTA" not in out


def test_without_trackeval_there_are_no_metrics(track, monkeypatch):
    monkeypatch.setitem(sys.modules, "trackeval.metrics", None)
    write_sequence("walk", truth=true_lines())
    code, out, err = track("walk", "--out", "out")
    assert code == 0, err
    assert "note: no metrics: tracking metrics need the package trackeval" in out
    assert len(text_of("walk").splitlines()) == 10


@pytest.mark.parametrize(
    ("name", "suffix"), [("coco", "json"), ("csv", "csv"), ("parquet", "parquet")]
)
def test_other_formats_hold_the_same(track, name, suffix):
    write_sequence("v1.2")
    assert track("v1.2", "--out", "out")[0] == 0
    assert track("v1.2", "--out", "out", "--format", name)[0] == 0
    assert files_in("out") == {"v1.2.txt", f"v1.2.{suffix}", "config.yaml"}
    one, other = read_tracks("out/v1.2.txt"), read_tracks(f"out/v1.2.{suffix}")
    for key in ("frame", "identity", "box"):
        np.testing.assert_allclose(getattr(one, key), getattr(other, key))
    np.testing.assert_allclose(one.confidence, other.confidence, rtol=1e-6)


def test_videos_where_there_are_frames(track):
    write_frames(write_sequence("walk", lines([2, 3])), 5)
    write_sequence("blind")
    code, out, err = track("walk", "blind", "--out", "out", "--video")
    assert code == 0, err
    assert files_in("out") == {"walk.txt", "walk.mp4", "blind.txt", "config.yaml"}
    assert "note: blind: no video, as there are no frames" in out
    assert "picture: out/walk.mp4" in out
    frames = VideoFrames("out/walk.mp4")
    assert len(frames) == 5
    assert np.abs(frames[0][:200].astype(int) - 90).max() < 12
    assert np.abs(frames[1][:200].astype(int) - 90).max() > 60
    assert seen()[0].images is not None


def test_a_run_that_is_interrupted_leaves_what_it_has_finished(track):
    for name in ("a", "b", "c"):
        write_frames(write_sequence(name), 5)
    stopping = write_config("stopping.yaml", stop_at=2)
    code, out, err = track("a", "b", "c", "--out", "out", "--video", config=stopping)
    assert (code, out) == (130, "")
    assert err == "mixer track: interrupted: finished, and in out: a\n"
    assert files_in("out") == {"a.txt", "a.mp4", "config.yaml"}
    assert track("a", "b", "c", "--out", "out")[0] == 0
    assert files_in("out") == {"a.txt", "b.txt", "c.txt", "a.mp4", "config.yaml"}


def test_an_error_on_the_way_leaves_what_was_finished(track):
    write_sequence("a")
    write_frames(write_sequence("b"), 5)
    Path("b/img1/000003.png").write_bytes(b"not an image")
    code, _, err = track("a", "b", "--out", "out", "--video")
    assert code == 2
    assert "b/img1/000003.png does not decode" in err
    assert files_in("out") == {"a.txt", "b.txt", "config.yaml"}


def test_what_a_tracker_cannot_do_names_the_sequence(track):
    write_sequence("a")
    scorer = [{"class_path": "scorers.Proximity"}]
    settings = {"scorers": scorer, "tracklet_scorers": scorer}
    tracker = {"class_path": "mixer_torch.tracking.Tracker", "init_args": settings}
    Path("places.yaml").write_text(yaml.safe_dump({"tracker": tracker}))
    code, _, err = track("a", "--out", "out", config="places.yaml")
    assert code == 2
    assert err.startswith("mixer track: error: a: ")
    assert "position" in err
    assert files_in("out") == {"config.yaml"}


def test_a_run_that_is_killed_leaves_nothing_half_written(track, tmp_path):
    for name in ("a", "b"):
        write_sequence(name)
    waiting = write_config("waiting.yaml", wait_at=2)
    command = "import sys; from mixer_torch.cli import main; sys.exit(main(sys.argv[1:]))"
    argv = ["track", "a", "b", "--out", "out", "--config", waiting]
    running = subprocess.Popen(
        [sys.executable, "-c", command, *argv], cwd=tmp_path, stderr=subprocess.PIPE
    )
    try:
        deadline = time.monotonic() + 120
        while not Path("waiting").exists() and running.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        running.kill()
        _, err = running.communicate()
    assert running.returncode == -signal.SIGKILL, err
    assert files_in("out") == {"a.txt", "config.yaml"}
    whole = text_of("a")
    assert track("a", "b", "--out", "out")[0] == 0
    assert text_of("a") == whole
    assert files_in("out") == {"a.txt", "b.txt", "config.yaml"}


def test_the_configuration_that_comes_with_the_project_follows_two_who_walk(track):
    rows = [
        f"{f},-1,{20 + 4 * f},{40 + k * 100},30,80,0.98,-1,-1,-1"
        for f in range(1, 31)
        for k in (0, 1)
    ]
    write_sequence("two", rows, length=30)
    code, out, err = track("two", "--out", "out", config=None)
    assert code == 0, err
    tracks = read_tracks("out/two.txt")
    assert len(tracks) == 60
    assert all(len(np.unique(tracks.identity[k::2])) == 1 for k in (0, 1))
    assert "status" in out


@pytest.mark.cuda
def test_on_a_gpu(track):
    write_sequence("walk")
    assert track("walk", "--out", "out", "--device", "cuda")[0] == 0
    assert seen()[0].device.type == "cuda"


@pytest.mark.real_data
def test_a_real_sequence_without_truth_or_pixels(real_data, track, tmp_path):
    pytest.importorskip("trackeval")
    os.symlink(real_data / "mot15" / "TUD-Stadtmitte", tmp_path / "TUD")
    code, out, err = track("TUD", "--out", "out", "--pixels", "false", config=None)
    assert code == 0, err
    columns = out.splitlines()[1].split()
    assert columns[:3] == ["TUD", "179", "951"]
    assert float(columns[8]) > 60
    assert len(read_tracks("out/TUD.txt")) > 700
    assert MOTChallenge("TUD").load()["identity"].dtype == torch.int64
