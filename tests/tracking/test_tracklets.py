"""Tracklets: summaries by hand, pairs against loops."""

import itertools

import pytest
import torch

from mixer_torch.observations import Observations
from mixer_torch.tracking.motion import MotionModel
from mixer_torch.tracking.tracklets import (
    PATH_FEATURES,
    overlapping,
    successive,
    summarised,
    with_paths,
    without_paths,
)


def walkers(spans, speed=10.0, camera=None):
    """One thing a span (first and last frame, 10 a second), side by side, and its labels."""
    frame = torch.cat([torch.arange(a, b + 1) for a, b in spans])
    label = torch.cat([torch.full((b - a + 1,), k) for k, (a, b) in enumerate(spans)])
    x = speed * frame / 10 + 30.0 * label
    box = torch.stack([x, torch.zeros_like(x), x + 20, torch.full_like(x, 50.0)], 1)
    features = {"frame": frame, "time": frame.double() / 10, "box": box}
    features["confidence"] = 0.5 + frame.float() / 100
    if camera is not None:
        features["camera"] = torch.tensor(camera)[label]
    return Observations(frame, features), label


def test_summary_of_two():
    observations, label = walkers([(3, 6), (0, 4)])
    tracklets = summarised(with_paths(observations, label, MotionModel()), label)
    assert tracklets.view.tolist() == [-1, -1]
    assert tracklets["span"].tolist() == [[0.3, 0.6], [0.0, 0.4]]
    assert tracklets["boxes"].tolist() == [4, 5]
    assert tracklets["confidence"].tolist() == pytest.approx([0.545, 0.52])
    assert [observations["frame"][i].item() for i in tracklets["first"]] == [3, 0]
    assert [observations["frame"][i].item() for i in tracklets["last"]] == [6, 4]
    velocity = tracklets["exit"][:, 0, 1]
    assert velocity.tolist() == pytest.approx([10, 10], rel=0.02)
    assert tracklets["entry"][:, 0, 1].tolist() == pytest.approx([10, 10], rel=0.02)


def test_no_tracklets():
    observations, label = walkers([(0, 1)])
    none = observations.select(torch.zeros(0, dtype=torch.int64))
    tracklets = summarised(with_paths(none, label[:0], MotionModel()), label[:0])
    assert len(tracklets) == 0
    assert overlapping(tracklets["span"]).shape == (2, 0)
    assert successive(tracklets, 1.0, 1.0, 1.0, 1.0).shape == (2, 0)


def test_overlaps_are_what_a_loop_finds():
    rng = torch.Generator().manual_seed(0)
    start = torch.randint(0, 20, (25,), generator=rng)
    span = torch.stack([start, start + torch.randint(0, 6, (25,), generator=rng)], 1).double()
    camera = torch.randint(0, 2, (25,), generator=rng)
    found = {tuple(p) for p in overlapping(span, camera).T.tolist()}
    expected = {
        (a, b)
        for a, b in itertools.combinations(range(25), 2)
        if camera[a] == camera[b] and span[a, 0] <= span[b, 1] and span[b, 0] <= span[a, 1]
    }
    assert found == expected


def test_successors_are_what_a_loop_finds():
    rng = torch.Generator().manual_seed(1)
    first = torch.randint(0, 30, (20,), generator=rng).tolist()
    length = torch.randint(0, 6, (20,), generator=rng).tolist()
    camera = torch.randint(0, 2, (20,), generator=rng).tolist()
    spans = [(a, a + n) for a, n in zip(first, length, strict=True)]
    observations, label = walkers(spans, camera=camera)
    tracklets = summarised(with_paths(observations, label, MotionModel()), label)
    found = [tuple(p) for p in successive(tracklets, 0.95, 0.5, 3.0, 0.5).T.tolist()]
    expected = []
    for a, b in itertools.combinations(range(20), 2):
        for i, j in ((a, b), (b, a)):
            seconds = (spans[j][0] - spans[i][1]) / 10
            end, start = tracklets["exit"][i, :, 0], tracklets["entry"][j, :, 0]
            far = (end - start)[:2].norm().item()
            near = far <= (0.5 + 3 * seconds) * 50
            if 0 < seconds <= 0.95 and near and camera[i] == camera[j]:
                expected.append((a, b))
    assert found == sorted(expected)
    assert found


def test_alone_is_a_path_of_one_box():
    observations, _ = walkers([(0, 3)])
    alone = torch.arange(4)
    fitted = with_paths(observations, alone, MotionModel())
    direct = without_paths(observations, MotionModel())
    for key in PATH_FEATURES:
        torch.testing.assert_close(fitted[key], direct[key])
