"""`mixer track`: what is written and said, for good input, bad input, and interrupted runs."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from track_inputs import (
    files_in,
    lines,
    seen,
    text_of,
    true_lines,
    write_config,
    write_frames,
    write_sequence,
)

from mixer_torch.association import Status
from mixer_torch.datasets import MOTChallenge
from mixer_torch.io.tracks import read_tracks
from mixer_torch.observations import VideoFrames


def test_each_sequence_has_a_result_and_a_line(track):
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


def test_a_tracker_that_works_online_says_how_long_frames_take(track):
    write_sequence("walk")
    online = write_config("online.yaml", latency=0.002)
    code, out, err = track("walk", "--out", "out", config=online)
    assert code == 0, err
    assert "walk: 2.0 ms a frame (median), 2.2 ms for 99 of 100, 20.0 ms at worst" in out


def test_later_benchmarks_have_classes_and_scores_of_other_scales(track):
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
    write_sequence("walk", truth=true_lines())
    code, out, _ = track("walk", "--out", "out", "--start", 2, "--stop", 4, "--step", 2)
    assert code == 0
    assert seen()[0]["frame"].tolist() == [2, 2, 4, 4]
    assert out.splitlines()[1].split()[1:4] == ["2", "4", "2"]
    assert out.splitlines()[1].split()[6] == "100.0"


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


def test_videos_with_frames_and_without(track):
    write_frames(write_sequence("walk", lines([2, 3])), 5)
    write_sequence("blind")
    code, out, err = track("walk", "blind", "--out", "out", "--video")
    assert code == 0, err
    assert files_in("out") == {"walk.txt", "walk.mp4", "blind.txt", "blind.mp4", "config.yaml"}
    assert "note: blind: no frames, so the video has a plain ground" in out
    plain = VideoFrames("out/blind.mp4")
    assert (len(plain), plain[0].shape) == (5, (240, 320, 3))
    assert plain[0][120:200].std() < 8 < plain[0].std()
    assert "video: out/walk.mp4" in out
    frames = VideoFrames("out/walk.mp4")
    assert len(frames) == 5
    assert np.abs(frames[0][:200].astype(int) - 90).max() < 12
    assert np.abs(frames[1][:200].astype(int) - 90).max() > 60
    assert seen()[0].images is not None


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
    os.symlink(real_data / "mot15" / "TUD-Stadtmitte", tmp_path / "TUD")
    code, out, err = track("TUD", "--out", "out", "--pixels", "false", config=None)
    assert code == 0, err
    columns = out.splitlines()[1].split()
    assert columns[:3] == ["TUD", "179", "951"]
    assert float(columns[8]) > 60
    assert len(read_tracks("out/TUD.txt")) > 700
    assert MOTChallenge("TUD").load()["identity"].dtype == torch.int64
