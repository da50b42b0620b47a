"""The causal start: straight walkers are told apart, in whatever direction of time."""

import pytest
import torch

from mixer_torch.association import by_first_appearance
from mixer_torch.observations import Observations
from mixer_torch.tracking.causal import causal_labels
from mixer_torch.tracking.motion import MotionModel


def walkers(starts, speeds, frames=30, camera=None, rate=10.0):
    """Boxes of people 100 pixels high who walk along x, and who they are."""
    frame = torch.arange(frames).repeat_interleave(len(starts))
    who = torch.arange(len(starts)).repeat(frames)
    x = torch.tensor(starts)[who] + torch.tensor(speeds)[who] * frame / rate
    box = torch.stack([x - 20, torch.zeros_like(x), x + 20, torch.full_like(x, 100.0)], 1)
    features = {"time": frame.double() / rate, "box": box, "frame": frame}
    if camera is not None:
        features["camera"] = torch.tensor(camera)[who]
    return Observations(frame, features), who


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("strangers", [0.01, 0.1])
def test_walkers_who_cross(backwards, strangers):
    observations, who = walkers([0.0, 123.0, 500.0], [40.0, -40.0, 0.0])
    found = causal_labels(
        observations, MotionModel(), 2.0, strangers=strangers, backwards=backwards
    )
    assert by_first_appearance(found).tolist() == by_first_appearance(who).tolist()


def test_paths_end_where_they_are_not_seen_for_long():
    observations, _ = walkers([0.0], [40.0])
    seen = observations.select((observations["frame"] < 10) | (observations["frame"] >= 14))
    for patience, count in ((0.3, 2), (0.5, 1)):
        found = causal_labels(seen, MotionModel(), 2.0, patience=patience)
        assert len(found.unique()) == count


def test_cameras_are_apart():
    observations, who = walkers([0.0, 5.0], [10.0, 10.0], camera=[0, 1])
    found = causal_labels(observations, MotionModel(), 2.0)
    assert by_first_appearance(found).tolist() == who.tolist()


def test_order_makes_no_difference():
    observations, _ = walkers([0.0, 123.0, 500.0], [40.0, -40.0, 0.0])
    order = torch.randperm(len(observations), generator=torch.Generator().manual_seed(0))
    straight = causal_labels(observations, MotionModel(), 2.0)[order]
    mixed = causal_labels(observations.select(order), MotionModel(), 2.0)
    assert by_first_appearance(straight).tolist() == by_first_appearance(mixed).tolist()


def test_nothing_seen():
    observations, _ = walkers([0.0], [0.0], frames=1)
    assert causal_labels(observations, MotionModel(), 2.0).tolist() == [0]
    none = observations.select(torch.zeros(0, dtype=torch.int64))
    assert causal_labels(none, MotionModel(), 2.0).tolist() == []
