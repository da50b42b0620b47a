"""Tracking while the camera moves: with its motion taken out, as if it rested."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from mixer_torch.association import by_first_appearance
from mixer_torch.datasets import MOTChallenge
from mixer_torch.io.tracks import read_mot_truth
from mixer_torch.observations import Images, Observations
from mixer_torch.tracking import CameraMotion, PostProcessing, Tracker, Tracks

WIDTH, HEIGHT, RATE = 320, 240, 20.0


def tracker(**settings):
    return Tracker(**{"camera": CameraMotion(), **settings})


def filmed_people(count=60, sway=60.0, hidden=()):
    """Three who walk in front of a painted wall, filmed by a camera that sways to and fro.

    Returns:
        Observations, who they are, and the true box of (frame, who).
    """
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.normal(size=(300, 600, 3)), (0, 0), 4)
    wall = (128 + 40 * noise / noise.std()).clip(0, 255).astype(np.uint8)
    frames, rows, truth = [], [], {}
    for k in range(count):
        time = k / RATE
        left = 140 + round(sway * np.sin(2 * np.pi * time)) + rng.integers(-2, 3)
        frames.append(wall[30 : 30 + HEIGHT, left : left + WIDTH].copy())
        for who, (x, y, speed) in enumerate([(240, 90, 30), (330, 100, -30), (285, 150, 0)]):
            x, y = x + speed * time - left, y - 30.0
            truth[k + 1, who] = np.array([x - 15, y - 40, x + 15, y + 40])
            if not any(who == one and a <= k + 1 <= b for one, a, b in hidden):
                rows.append((k + 1, who, *(truth[k + 1, who] + rng.normal(size=4) * 0.5)))
    table = torch.tensor(np.array(rows))
    frame = table[:, 0].long()
    features = {
        "frame": frame,
        "time": (frame - 1).double() / RATE,
        "box": table[:, 2:].float(),
        "confidence": torch.full((len(frame),), 0.99),
    }
    images = Images(frames, frame.numpy() - 1, table[:, 2:].numpy())
    return Observations(frame, features, images), table[:, 1].long(), truth


def same(found, expected):
    return by_first_appearance(found).tolist() == by_first_appearance(expected).tolist()


def test_people_are_told_apart_while_the_camera_sways():
    observations, who, _ = filmed_people()
    told = []
    labels = tracker().associate(observations, lambda *what: told.append(what)).labels
    assert same(labels, who)
    assert ("camera motion", 60, 60) in told


def test_boxes_come_out_where_they_were_seen_smoothed_and_filled():
    observations, who, truth = filmed_people(hidden=[(0, 25, 33)])
    ours = tracker(post=PostProcessing(fill=1.0))
    association = ours.associate(observations)
    assert same(association.labels, who)
    tracks = ours.finish(observations, association)
    assert (tracks.observation < 0).sum() == 9
    for row in range(len(tracks)):
        expected = truth[int(tracks.frame[row]), int(tracks.identity[row]) - 1]
        assert tracks.box[row] == pytest.approx(expected, abs=2.5)


def test_boxes_are_as_detected_where_nothing_smooths_them():
    observations, _, _ = filmed_people(count=30)
    tracks = tracker(post=PostProcessing(smoothing=0)).track(observations)
    box = observations["box"].double().numpy()[tracks.observation]
    assert len(tracks) == len(observations)
    assert tracks.box == pytest.approx(box, abs=1e-6)


def test_without_pixels_the_tracker_says_so():
    observations, _, _ = filmed_people(count=3)
    blind = replace(observations, images=None)
    with pytest.raises(ValueError, match="camera_motion: expected observations with images"):
        tracker().associate(blind)


def test_no_observations_no_tracks():
    observations, _, _ = filmed_people(count=1)
    none = observations.select(torch.zeros(3, dtype=torch.bool))
    assert len(tracker().track(none)) == 0


def windowed(observations, truth, left, top, width=480, height=360):
    """What a window that moves over the pictures shows: half of a box at least."""

    def cut(frame, box):
        corner = np.stack([left, top, left, top], 1)[frame - 1]
        moved = box - corner
        shown = moved.clip(0, [width, height, width, height])
        area, of = ((one[:, 2:] - one[:, :2]).prod(1) for one in (shown, moved))
        return area >= 0.5 * of, shown

    frames = observations.images.frames
    pictures = [
        frames[k][y : y + height, x : x + width].copy()
        for k, (x, y) in enumerate(zip(left, top, strict=True))
    ]
    frame = observations["frame"].numpy()
    keep, box = cut(frame, observations["box"].double().numpy())
    seen = observations.select(torch.from_numpy(keep))
    seen = seen.with_features(box=torch.from_numpy(box[keep]).float())
    seen = replace(seen, images=Images(pictures, frame[keep] - 1, box[keep]))
    keep, box = cut(truth.frame, truth.box)
    return seen, Tracks(truth.frame[keep], truth.identity[keep], box[keep])


@pytest.mark.real_data
def test_a_moving_window_on_real_people(real_data):
    """A pan of 60 pixels and 2 seconds, shaken by 2 pixels: seen in pixels, and in boxes."""
    from mixer_torch.metrics.tracking import evaluate_sequences

    folder = real_data / "mot15" / "TUD-Stadtmitte"
    observations = MOTChallenge(folder, truth=False).load()
    truth = read_mot_truth(folder / "gt" / "gt.txt", [1]).tracks
    rng = np.random.default_rng(0)
    time = np.arange(len(observations.images.frames)) / 25
    left = 80 + 60 * np.sin(np.pi * time) + 2 * rng.normal(size=len(time))
    top = 60 + 18 * np.cos(0.7 * np.pi * time) + 2 * rng.normal(size=len(time))
    seen, true = windowed(observations, truth, left.round().astype(int), top.round().astype(int))
    found = {"pixels": tracker(), "boxes": tracker(camera=None)}
    idf1 = {
        name: evaluate_sequences({"a": one.track(seen)}, {"a": true})["combined"]["IDF1"]
        for name, one in found.items()
    }
    assert idf1["pixels"] > 65
    assert idf1["boxes"] > 60
