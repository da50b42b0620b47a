"""MOTChallenge sequences: what is read, what truth is attached, and what is refused."""

import cv2
import numpy as np
import pytest
import torch

import mixer_torch as mx
from mixer_torch.boxes import corners
from mixer_torch.datasets import MOTChallenge
from mixer_torch.io.motchallenge import read_table
from mixer_torch.metrics.calibration import area_under_roc
from mixer_torch.scorers import Proximity
from mixer_torch.train.selectors import AtGaps

SEQINFO = "[Sequence]\nname=toy\nimDir=img1\nframeRate=10\nseqLength=4\nimExt=.png\n"
DET = """\
2,-1,100,50,20,40,0.9,-1,-1,-1
1,-1,10,20,30,60,0.8,-1,-1,-1
1,-1,200,20,30,60,0.3,-1,-1,-1
4,-1,12,20,30,60,0.7,-1,-1,-1
"""
GT = """\
1,7,12,22,30,60,1,-1,-1,-1
1,8,200,20,30,60,0,-1,-1,-1
2,9,300,50,20,40,1,-1,-1,-1
4,7,12,20,30,60,1,-1,-1,-1
"""


@pytest.fixture
def sequence(tmp_path):
    (tmp_path / "det").mkdir()
    (tmp_path / "gt").mkdir()
    (tmp_path / "seqinfo.ini").write_text(SEQINFO)
    (tmp_path / "det" / "det.txt").write_text(DET)
    (tmp_path / "gt" / "gt.txt").write_text(GT)
    return tmp_path


def write_frames(folder, frames):
    (folder / "img1").mkdir(exist_ok=True)
    for k in frames:
        image = np.full((100, 320, 3), (0, 0, 10 * k), np.uint8)
        assert cv2.imwrite(str(folder / "img1" / f"{k:06d}.png"), image)


def test_detections_with_truth(sequence):
    seen = MOTChallenge(sequence).load()
    assert seen.view.tolist() == [1, 1, 2, 4]
    assert seen["frame"].tolist() == [1, 1, 2, 4]
    assert seen["time"].tolist() == pytest.approx([0, 0, 0.1, 0.3])
    assert seen["camera"].tolist() == [0] * 4
    assert seen["box"][0].tolist() == [10, 20, 40, 80]
    assert seen["confidence"].tolist() == pytest.approx([0.8, 0.3, 0.9, 0.7])
    # The second lies on a region to ignore, the third on nothing.
    assert seen["identity"].tolist() == [7, -1, -1, 7]
    assert "position" not in seen.features
    assert seen.images is None


def test_without_truth_there_is_no_identity(sequence):
    (sequence / "gt" / "gt.txt").unlink()
    assert "identity" not in MOTChallenge(sequence).load().features
    with pytest.raises(FileNotFoundError, match=r"gt\.txt"):
        MOTChallenge(sequence, source="gt").load()


def test_true_boxes(sequence):
    seen = MOTChallenge(sequence, source="gt").load()
    assert seen["identity"].tolist() == [7, 9, 7]
    assert seen["confidence"].tolist() == [1, 1, 1]


def test_frames_and_confidence(sequence):
    assert MOTChallenge(sequence, start=2).load().view.tolist() == [2, 4]
    assert MOTChallenge(sequence, start=1, stop=4, step=3).load().view.tolist() == [1, 1, 4]
    assert MOTChallenge(sequence, stop=1).load().view.tolist() == [1, 1]
    assert MOTChallenge(sequence, start=3, stop=3).load().view.tolist() == []
    assert MOTChallenge(sequence, min_confidence=0.7).load().view.tolist() == [1, 2, 4]


def test_classes_of_later_benchmarks(sequence):
    lines = "1,7,12,22,30,60,1,1,0.9\n1,8,200,20,30,60,1,3,0.9\n2,9,100,50,20,40,0,1,1\n"
    (sequence / "gt" / "gt.txt").write_text(lines)
    assert MOTChallenge(sequence).load()["identity"].tolist() == [7, -1, -1, -1]
    both = MOTChallenge(sequence, classes=(1, 3)).load()
    assert both["identity"].tolist() == [7, 8, -1, -1]


def test_position_through_a_homography(sequence):
    (sequence / "homography.txt").write_text("0.01 0 0\n0 0.02 0\n0 0 1\n")
    seen = MOTChallenge(sequence).load()
    assert seen["position"].dtype == torch.float32
    np.testing.assert_allclose(seen["position"][0], [0.25, 1.6, 0], rtol=1e-6)
    (sequence / "other.txt").write_text("0.1 0 0\n0 0.1 0\n0 0 1\n")
    other = MOTChallenge(sequence, calibration=sequence / "other.txt").load()
    np.testing.assert_allclose(other["position"][0], [2.5, 8, 0], rtol=1e-6)


def walkers(folder, people=((100, 5), (300, -5)), frames=40):
    """Left edge at first and pixels a frame; feet are 3 pixels too high and too low in turns."""
    (folder / "homography.txt").write_text("0.01 0 0\n0 0.01 0\n0 0 1\n")
    detections, truth = [], []
    for frame in range(1, frames + 1):
        for person, (x, speed) in enumerate(people):
            left = x + speed * (frame - 1)
            detections.append(f"{frame},-1,{left},{50 + 3 * (-1) ** frame},30,60,0.9,-1,-1,-1")
            truth.append(f"{frame},{person + 1},{left},50,30,60,1,-1,-1,-1")
    (folder / "det" / "det.txt").write_text("\n".join(detections))
    (folder / "gt" / "gt.txt").write_text("\n".join(truth))


@pytest.mark.parametrize("source", ["det", "gt"])
def test_velocity_comes_from_the_frames_between(sequence, source):
    walkers(sequence)
    few = {"start": 10, "stop": 30, "step": 10, "source": source}
    seen = MOTChallenge(sequence, window=0.5, **few).load()
    assert seen["frame"].tolist() == [10, 10, 20, 20, 30, 30]
    assert seen["velocity"].dtype == seen["position"].dtype == torch.float32
    walk = np.where(seen["identity"] == 1, 0.5, -0.5)
    np.testing.assert_allclose(seen["velocity"][:, 0], walk, atol=1e-6)
    # 11 boxes around each: the shaking feet are 3 cm off once, 3 mm on the average of the path.
    start = np.where(seen["identity"] == 1, 1.15, 3.15) + walk * seen["time"].numpy()
    np.testing.assert_allclose(seen["position"][:, 0], start, atol=1e-6)
    np.testing.assert_allclose(seen["position"][:, 1], 1.1, atol=0.004)
    assert not seen["position"][:, 2].any()
    plain = MOTChallenge(sequence, **few).load()
    assert "velocity" not in plain.features
    for name in ("frame", "box", "identity", "confidence"):
        assert torch.equal(plain[name], seen[name])


def test_who_walks_behind_is_told_apart_by_velocity(sequence):
    # After 20 frames, one is where the other was.
    walkers(sequence, [(100, 5), (200, 5)])
    few = {"start": 11, "stop": 31, "step": 20}
    seen = MOTChallenge(sequence, window=0.5, **few).load()
    pairs = mx.Every()(seen)
    same = seen["identity"][pairs[0]] == seen["identity"][pairs[1]]
    keeps = Proximity(scale=0.3, memory=5, swerve=0.1)(seen, pairs)
    stays = Proximity(scale=0.3, memory=5)(seen, pairs)
    assert bool((keeps[same] > 0.6).all() and (keeps[~same] < 0.4).all())
    assert bool((stays[same] < 0.4).all() and (stays[~same] > 0.6).any())


def test_velocity_is_missing_where_it_cannot_be_told(sequence):
    (sequence / "homography.txt").write_text("0.01 0 0\n0 0.02 0\n0 0 1\n")
    seen = MOTChallenge(sequence, window=0.5).load()
    assert seen["velocity"].isnan().all()
    assert torch.equal(seen["position"], MOTChallenge(sequence).load()["position"])
    (sequence / "det" / "det.txt").write_text("")
    assert MOTChallenge(sequence, window=0.5).load()["velocity"].shape == (0, 3)


def test_velocity_needs_a_calibration(sequence):
    with pytest.raises(FileNotFoundError, match=r"no calibration, which window .*0\.5"):
        MOTChallenge(sequence, window=0.5).load()


def test_position_above_the_horizon_is_missing(sequence):
    (sequence / "homography.txt").write_text("1 0 0\n0 1 0\n0 1 -85\n")
    position = MOTChallenge(sequence).load()["position"]
    assert position.isnan().all(1).tolist() == [True, True, False, True]


def test_frames_from_the_folder(sequence):
    write_frames(sequence, [1, 2, 4])
    seen = MOTChallenge(sequence).load()
    assert [seen.images.crop(i)[0, 0, 0] for i in range(4)] == [10, 10, 20, 40]
    assert seen.images.crop(0).shape == (60, 30, 3)
    assert MOTChallenge(sequence, pixels=False).load().images is None


def test_missing_frames(sequence):
    write_frames(sequence, [1, 4])
    assert MOTChallenge(sequence).load().images is None
    assert MOTChallenge(sequence, step=3).load().images is not None
    with pytest.raises(FileNotFoundError, match=r"000002\.png does not exist"):
        MOTChallenge(sequence, pixels=True).load()


def test_frames_from_the_video(sequence):
    (sequence / "video").mkdir()
    file = sequence / "video" / "toy.avi"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"MJPG"), 10, (320, 100))
    for k in range(1, 5):
        writer.write(np.full((100, 320, 3), 40 * k, np.uint8))
    writer.release()
    seen = MOTChallenge(sequence).load()
    brightness = [int(seen.images.crop(i).mean()) for i in range(4)]
    np.testing.assert_allclose(brightness, [40, 40, 80, 160], atol=3)
    (sequence / "det" / "det.txt").write_text("5,-1,10,20,30,60,0.8\n")
    assert MOTChallenge(sequence).load().images is None
    with pytest.raises(FileNotFoundError, match=r"000005\.png does not exist"):
        MOTChallenge(sequence, pixels=True).load()
    (sequence / "video" / "second.mp4").touch()
    with pytest.raises(ValueError, match="expected one video"):
        MOTChallenge(sequence).load()


@pytest.mark.parametrize("text", ["", "\n \n"])
def test_empty_detections(sequence, text):
    (sequence / "det" / "det.txt").write_text(text)
    (sequence / "homography.txt").write_text("1 0 0\n0 1 0\n0 0 1\n")
    seen = MOTChallenge(sequence).load()
    assert len(seen) == 0
    assert seen["box"].shape == (0, 4)
    assert seen["position"].shape == (0, 3)
    assert seen["identity"].dtype == torch.int64
    (sequence / "img1").mkdir()
    assert len(MOTChallenge(sequence).load().images) == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\n1,-1,1,2,3,4,1\n1,-1,1,2,wide,4,1\n", "line 3: expected a number, got 'wide'"),
        ("1,-1,1,2,3,4,1\n1,-1,1,2,3,4\n", "line 2: expected 7 numbers, got 6"),
        ("1,-1,1,2,3,4\n", "line 1: expected at least 7 numbers, got 6"),
        ("1,-1,1,2,3,4,1\n\n0,-1,1,2,3,4,1\n", "line 3: expected a frame of 1 or more"),
        ("1.5,-1,1,2,3,4,1\n", "line 1: expected a frame"),
        ("1,-1,1,2,3,4,1\n1,-1,1,2,0,4,1\n", "line 2: expected a positive width and height"),
        ("1,-1,1,2,3,-4,1\n", "line 1: expected a positive width"),
        ("1,-1,nan,2,3,4,1\n", "line 1: a number is not finite"),
        ("1;-1;1;2;3;4;1\n", "line 1: expected a number, got"),
    ],
)
def test_malformed_detections(sequence, text, message):
    file = sequence / "det" / "det.txt"
    file.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        MOTChallenge(sequence).load()
    assert str(file) in str(caught.value)


def test_malformed_truth(sequence):
    file = sequence / "gt" / "gt.txt"
    file.write_text("1,7,1,2,3,4,1\n1,8,1,2,3,4,1\n1,7,9,9,3,4,1\n")
    with pytest.raises(ValueError, match=r"gt\.txt, line 3: this identity is in this frame"):
        MOTChallenge(sequence).load()
    file.write_text("1,-1,1,2,3,4,1\n")
    with pytest.raises(ValueError, match="line 1: expected an identity"):
        MOTChallenge(sequence).load()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frameRate=10", "not readable as an ini file"),
        ("[Other]\nframeRate=10", "'Sequence' is missing"),
        ("[Sequence]\nname=x", "'frameRate' is missing"),
        ("[Sequence]\nframeRate=fast", "expected a number, got 'fast'"),
        ("[Sequence]\nframeRate=0", "expected a positive number"),
    ],
)
def test_malformed_seqinfo(sequence, text, message):
    (sequence / "seqinfo.ini").write_text(text)
    with pytest.raises(ValueError, match=message):
        MOTChallenge(sequence).load()


def test_missing_files(sequence, tmp_path, monkeypatch):
    monkeypatch.delenv("MIXER_DATA", raising=False)
    with pytest.raises(FileNotFoundError, match="nowhere"):
        MOTChallenge(tmp_path / "nowhere").load()
    (sequence / "det" / "det.txt").unlink()
    with pytest.raises(FileNotFoundError, match=r"det\.txt"):
        MOTChallenge(sequence).load()
    (sequence / "seqinfo.ini").unlink()
    with pytest.raises(FileNotFoundError, match=r"seqinfo\.ini"):
        MOTChallenge(sequence).load()


def test_found_in_the_data_folder(sequence, monkeypatch):
    monkeypatch.setenv("MIXER_DATA", str(sequence.parent))
    assert len(MOTChallenge(sequence.name).load()) == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step": 0}, "step"),
        ({"source": "dets"}, "source"),
        ({"min_overlap": 0.0}, "min_overlap"),
        ({"window": -1.0}, "window: expected a finite number >= 0, got -1.0"),
        ({"window": float("nan")}, "window"),
        ({"window": float("inf")}, "window"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises((ValueError, TypeError), match=message):
        MOTChallenge("anywhere", **arguments)


def test_long_tables_read(tmp_path):
    line = "3,-1,100.25,50.5,20,40,0.9,-1,-1,-1\n"
    (tmp_path / "det.txt").write_text(line * 100_000)
    rows, number = read_table(tmp_path / "det.txt")
    assert rows.shape == (100_000, 10)
    assert number[-1] == 100_000
    assert corners(rows[:, 2:6])[-1].tolist() == [100.25, 50.5, 120.25, 90.5]


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "detections", "matched"),
    [
        ("PETS09-S2L1", 4359, 0.75),
        ("TUD-Stadtmitte", 951, 0.9),
        ("ETH-Bahnhof", 6209, 0.5),
        ("ADL-Rundle-6", 4325, 0.65),
        ("KITTI-17", 592, 0.8),
    ],
)
def test_real_sequences(real_data, name, detections, matched):
    seen = MOTChallenge(real_data / "mot15" / name).load()
    assert len(seen) == detections
    assert (seen["identity"] >= 0).float().mean() > matched
    named = torch.stack([seen.view, seen["identity"]])[:, seen["identity"] >= 0]
    assert torch.unique(named, dim=1).shape == named.shape


@pytest.mark.real_data
def test_the_benchmark_window_of_pets(real_data):
    path = real_data / "mot15" / "PETS09-S2L1"
    seen = MOTChallenge(path, start=160, stop=780, step=20, pixels=True).load()
    assert len(seen.view.unique()) == 32
    assert seen.images.frame(0).shape == (576, 768, 3)
    assert seen["position"].isfinite().all()
    assert MOTChallenge(path).load().images is None


@pytest.mark.real_data
def test_velocity_tells_people_apart_better_than_distance(real_data):
    # Sightings 2.9 s apart: where both would be halfway, against where they were.
    seen = MOTChallenge("mot15/PETS09-S2L1", stop=150, pixels=False, window=1.0).load()
    pairs = AtGaps([20], "frame", 0)(seen)
    known = seen["velocity"].isfinite().all(1)
    assert known.double().mean() > 0.6  # not of people half hidden, whose boxes come and go
    pairs = pairs[:, known[pairs].all(0) & (seen["identity"][pairs] >= 0).all(0)]
    same = seen["identity"][pairs[0]] == seen["identity"][pairs[1]]
    stays, keeps = (
        area_under_roc(torch.logit(Proximity(2.0, 5.0, swerve=swerve)(seen, pairs).double()), same)
        for swerve in (None, 0.0)
    )
    assert keeps > stays + 0.05
