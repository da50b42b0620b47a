"""Motion: what speaks for one path, what against, and what says nothing."""

import math

import pytest
import torch

from mixer_torch.observations import Observations
from mixer_torch.scorers import Motion
from mixer_torch.tracking.motion import MotionModel, State, log_ratio
from mixer_torch.tracking.tracklets import with_paths


def walk(x, times, camera=None, confidence=None):
    """Boxes 100 pixels high at x, one a time."""
    x, time = torch.tensor(x).double(), torch.tensor(times).double()
    box = torch.stack([x - 20, 0 * x, x + 20, 0 * x + 100], 1).float()
    features = {"time": time, "box": box}
    if camera is not None:
        features["camera"] = torch.tensor(camera)
    if confidence is not None:
        features["confidence"] = torch.tensor(confidence)
    return Observations(torch.arange(len(x)), features)


def pair(a, b):
    return torch.tensor([[a], [b]])


def test_who_walks_on_is_the_same_and_who_turns_back_is_not():
    times = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0]
    observations = walk([0, 20, 40, 60, 80, 100, 60, 20], times)
    labels = torch.tensor([0, 0, 0, 0, 0, 1, 2, 3])
    known = with_paths(observations, labels, MotionModel())
    scorer = Motion(limit=50.0)
    onwards, back, far_back = (float(scorer(known, pair(4, b))) for b in (5, 6, 7))
    assert onwards > 0.9
    assert onwards > back > far_back
    assert far_back < 0.1


def test_backwards_in_time_is_the_same():
    times = [0.0, 0.2, 0.4, 0.9, 1.1, 1.3]
    x = [0.0, 22, 38, 95, 110, 133]
    labels = torch.tensor([0, 0, 0, 1, 1, 1])
    forwards = with_paths(walk(x, times), labels, MotionModel())
    mirrored = with_paths(walk(x, [-t for t in times]), labels, MotionModel())
    scorer = Motion(limit=50.0)
    there, back = (float(scorer.evidence(known, pair(2, 3))) for known in (forwards, mirrored))
    assert there == pytest.approx(back, rel=1e-3)


def test_evidence_is_the_ratio_and_its_burden():
    observations = walk([0.0, 10.0], [0.0, 0.5], confidence=[0.99, 0.9])
    known = with_paths(observations, torch.arange(2), MotionModel())
    states = [State.unpacked(known[key][i : i + 1]) for key, i in (("exit", 0), ("entry", 1))]
    half, height = torch.tensor([0.5]).double(), torch.tensor([100.0]).double()
    ratio = log_ratio(*states, half, height, MotionModel()).sum().item() - math.log(0.1)
    settings = {"strangers": 0.1, "limit": 50.0, "weight": 0.9}
    plain = float(Motion(**settings).evidence(known, pair(0, 1)))
    assert plain == pytest.approx(0.9 * ratio, rel=1e-6)
    burdened = Motion(**settings, prior=0.2, fade=0.3, doubt=0.4)
    burden = 0.2 + 0.3 * math.log(1 + 0.5 / 0.2) + 0.4 * math.log((1.02 - 0.9) / 0.05)
    assert float(burdened.evidence(known, pair(0, 1))) == pytest.approx(plain - burden, rel=1e-5)
    limited = Motion(strangers=0.1, limit=1.0, weight=0.9)
    assert float(limited.evidence(known, pair(0, 1))) == pytest.approx(0.9)


def test_a_gap_alone_is_no_evidence_against():
    observations = walk([0.0, 10.0], [0.0, 0.5])
    assert float(Motion(prior=100.0)(observations, pair(0, 1))) == 0.5
    apart = walk([0.0, 2000.0], [0.0, 0.5])
    scores = [float(Motion(prior=prior)(apart, pair(0, 1))) for prior in (0.0, 100.0)]
    assert scores[0] == scores[1] < 0.1


def test_other_cameras_and_one_moment_say_nothing():
    observations = walk([0.0, 0, 0], [0.0, 0.1, 0.1], camera=[0, 1, 0])
    scorer = Motion()
    assert float(scorer(observations, pair(0, 1))) == 0.5
    assert float(scorer(observations, pair(1, 2))) == 0.5
    assert float(scorer(observations, pair(0, 2))) > 0.5


@pytest.mark.parametrize("name", ["strangers", "weight", "limit"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_settings(name, value):
    with pytest.raises(ValueError, match=name):
        Motion(**{name: value})


@pytest.mark.parametrize("name", ["prior", "fade", "doubt"])
def test_burdens_are_finite(name):
    with pytest.raises(ValueError, match=name):
        Motion(**{name: float("nan")})
