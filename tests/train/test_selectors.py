"""Pairs at given distances, against all pairs."""

import pytest
import torch

import mixer_torch as mx
from mixer_torch.observations import Observations
from mixer_torch.train.selectors import AtGaps


def seen(m=40):
    frame = torch.arange(m) // 2
    return Observations(frame, {"frame": frame, "time": frame / 7.0})


def test_they_are_those_of_all_pairs():
    observations = seen()
    every = mx.Every()(observations)
    apart = (observations["frame"][every[0]] - observations["frame"][every[1]]).abs()
    expected = every[:, (apart == 3) | (apart == 6)]
    assert torch.equal(AtGaps([3, 6], "frame", 0)(observations), expected)
    assert torch.equal(AtGaps([3 / 7, 6 / 7], tolerance=0.05)(observations), expected)
    assert len(expected[0]) == 4 * (17 + 14)


def test_none_are_far_enough_apart():
    assert AtGaps([100.0])(seen()).shape == (2, 0)
    assert AtGaps([1.0])(seen(0)).shape == (2, 0)


@pytest.mark.parametrize(("gaps", "tolerance"), [([], 0.1), ([0.0], 0.1), ([1.0], -1.0)])
def test_bad_arguments_are_named(gaps, tolerance):
    with pytest.raises(ValueError, match=r"gaps|tolerance"):
        AtGaps(gaps, tolerance=tolerance)
