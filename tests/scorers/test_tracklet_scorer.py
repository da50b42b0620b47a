"""Tracklet: one tracklet, two at once, and one after the other."""

import math

import pytest
import torch

from mixer_torch.observations import Observations
from mixer_torch.scorers import Tracklet
from mixer_torch.tracking.motion import MotionModel, State, log_ratio
from mixer_torch.tracking.tracklets import summarised, tracklet_features, with_paths

TIMES = [0.0, 0.2, 0.4, 0.8, 1.0, 1.2]


def seen(x=(0.0, 20.0, 40.0, 80.0, 100.0, 120.0), labels=(0, 0, 0, 1, 1, 1), **features):
    """Boxes 100 pixels high at x, of these tracklets."""
    x, time, labels = torch.tensor(x).double(), torch.tensor(TIMES).double(), torch.tensor(labels)
    box = torch.stack([x - 20, 0 * x, x + 20, 0 * x + 100], 1)
    features = {"time": time, "box": box} | features
    observations = Observations(torch.arange(len(x)), features)
    tracklets = summarised(with_paths(observations, labels, MotionModel()), labels)
    return observations.with_features(**tracklet_features(tracklets, labels))


def evidence(observations, a, b, **settings):
    return float(Tracklet(**settings).evidence(observations, torch.tensor([[a], [b]])))


def test_one_tracklet_is_beyond_all_else_and_two_at_once_are_below():
    observations = seen(labels=(0, 1, 0, 1, 1, 0))
    assert evidence(observations, 0, 5) == 7.0
    assert evidence(observations, 0, 1) == -7.0
    assert evidence(observations, 0, 1, limit=2.0) == -3.0


def test_one_after_the_other_is_the_ratio_of_their_ends():
    observations = seen()
    known = with_paths(observations, torch.tensor([0, 0, 0, 1, 1, 1]), MotionModel())
    ends = State.unpacked(known["exit"][2:3]), State.unpacked(known["entry"][3:4])
    seconds, height = torch.tensor([0.4]).double(), torch.tensor([100.0]).double()
    ratio = float(log_ratio(*ends, seconds, height, MotionModel()).sum())
    expected = ratio - math.log(0.3)
    for a, b in ((2, 3), (0, 5), (1, 4)):  # whichever of theirs are compared
        assert evidence(observations, a, b, strangers=0.3, limit=50.0) == pytest.approx(expected)
    assert evidence(observations, 2, 3, strangers=0.3, limit=0.5) == 0.5


def test_who_goes_on_and_who_turns_back():
    onwards, back = seen(), seen(x=(0.0, 20.0, 40.0, 0.0, -20.0, -40.0))
    assert evidence(onwards, 2, 3) > 0 > evidence(back, 2, 3)


def test_another_camera_says_nothing():
    observations = seen(camera=torch.tensor([0, 0, 0, 1, 1, 1]))
    assert math.isnan(evidence(observations, 0, 5))
    assert evidence(observations, 0, 2) == 7.0


@pytest.mark.parametrize("name", ["strangers", "limit"])
def test_numbers_that_mean_nothing(name):
    with pytest.raises(ValueError, match=f"{name}: expected a positive number, got 0"):
        Tracklet(**{name: 0.0})
