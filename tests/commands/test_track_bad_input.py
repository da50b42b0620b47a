"""`mixer track` on input that is not as it should be, and interrupted."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from track_inputs import (
    SEQINFO,
    files_in,
    lines,
    seen,
    text_of,
    true_lines,
    write_config,
    write_frames,
    write_sequence,
)


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["here/walk", "there/walk"], "here/walk and there/walk are both called walk"),
        (["here/walk", "here/walk/."], "both called walk"),
        (["here/walk", "nowhere"], "nowhere: not found"),
        (["here/walk", "own_tracker.py"], "a folder, or a file in .txt, .json, .csv, .tsv"),
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


def test_without_a_tracker_it_is_the_default_one(track):
    write_sequence("walk")
    Path("none.yaml").write_text("tracker: null\n")
    code, _, _ = track("walk", "--out", "none", config="none.yaml")
    assert code == 0
    assert track("walk", "--out", "default")[0] == 0
    assert Path("none/walk.txt").read_text() == Path("default/walk.txt").read_text()


def result_of(track, rows, **other):
    """The result, what was said and the observations, of a sequence with these detections."""
    name = f"walk{len(list(Path('.').glob('walk*')))}"
    code, out, err = track(write_sequence(name, rows, **other), "--out", "out")
    assert code == 0, err
    assert files_in("out") >= {f"{name}.txt", "config.yaml"}
    return text_of(name), out, seen()[-1]


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


def test_truth_that_cannot_be_read_is_no_obstacle(track):
    write_sequence("walk", truth=["1,1,10,20,30"])
    code, out, err = track("walk", "--out", "out")
    assert code == 0, err
    assert "note: walk: no metrics, as the truth is not readable: walk/gt/gt.txt, line 1" in out
    assert "HOTA" not in out


@pytest.fixture
def heard():
    """Interrupts reach Python, also where whoever started the tests has them ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heard")
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
    assert files_in("out") == {"a.txt", "a.mp4", "b.txt", "config.yaml"}


def test_what_a_tracker_cannot_do_names_the_sequence(track):
    write_sequence("a")
    scorer = [{"class_path": "mixer_torch.scorers.Proximity"}]
    settings = {"scorers": scorer}
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
