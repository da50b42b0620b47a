"""Proximity: the formula by hand, its limits and its gradient."""

import math

import pytest
import torch

from mixer_torch.observations import Observations
from mixer_torch.pairs import Every
from mixer_torch.scorers import Proximity


def seen(positions, times):
    return Observations(
        torch.arange(len(times)),
        {
            "position": torch.tensor(positions, dtype=torch.float64),
            "time": torch.tensor(times, dtype=torch.float64),
        },
    )


def score(scorer, observations):
    return scorer(observations, Every()(observations)).tolist()


def test_formula_by_hand():
    observations = seen([[0, 0, 0], [3, 4, 0], [0, 0, 0]], [0.0, 0.0, 6.0])
    result = score(Proximity(scale=5.0, memory=3.0), observations)
    near = math.exp(-0.5)
    expected = [near, 0.5 + 0.5 * math.exp(-2), 0.5 + (near - 0.5) * math.exp(-2)]
    assert result == pytest.approx(expected, abs=1e-6)


def test_half_is_at_1_18_of_the_scale():
    distance = 2 * math.sqrt(2 * math.log(2))
    assert score(Proximity(scale=2.0), seen([[0, 0, 0], [distance, 0, 0]], [0.0, 0.0])) == (
        pytest.approx([0.5], abs=1e-6)
    )


def test_long_ago_says_nothing():
    result = score(Proximity(memory=10.0), seen([[0, 0, 0], [0, 0, 0], [90, 0, 0]], [0, 900, 1e6]))
    assert result == pytest.approx([0.5] * 3, abs=1e-6)


def test_what_moves_is_compared_beyond_its_reach():
    # In 2 s at 1.5 m/s it gets 3 m: 2 m and 3 m are as good as 0, 5 m is 2 m too far.
    observations = seen([[0, 0, 0], [2, 0, 0], [0, 3, 0], [5, 0, 0]], [0.0, 2.0, 2.0, 2.0])
    pairs = torch.tensor([[0, 0, 0], [1, 2, 3]])
    scorer = Proximity(scale=2.0, memory=math.inf, speed=1.5)
    assert scorer(observations, pairs).tolist() == pytest.approx([1, 1, math.exp(-0.5)], abs=1e-6)


def test_any_coordinates_will_do():
    point = torch.tensor([[0.0, 0.0], [0.0, 10.0]])
    observations = Observations(
        torch.arange(2), {"point": point, "time": torch.zeros(2, dtype=torch.float64)}
    )
    assert score(Proximity(scale=10.0, feature="point"), observations) == (
        pytest.approx([math.exp(-0.5)], abs=1e-6)
    )


def moving(positions, times, velocities):
    positions, velocities = ([[*row, 0][:3] for row in rows] for rows in (positions, velocities))
    velocity = torch.tensor(velocities, dtype=torch.float64)
    return seen(positions, times).with_features(velocity=velocity)


def test_what_keeps_its_velocity_by_hand():
    # Halfway, at 1 s, the first is at (2, 0), and the second, which was at (1, 3) at 2 s and goes
    # by (0, 1) a second, at (1, 2). They are sqrt(5) apart.
    observations = moving([[0, 0], [1, 3]], [0.0, 2.0], [[2, 0], [0, 1]])
    scorer = Proximity(scale=2.0, memory=math.inf, swerve=0.0)
    assert score(scorer, observations) == pytest.approx([math.exp(-5 / 8)], abs=1e-6)
    # Speeds of 2 and 1, and 0.1 more: within 2 s they may stray by 2 (0.1 + 0.2 * 1.5) = 0.8.
    scorer = Proximity(scale=2.0, memory=math.inf, speed=0.1, swerve=0.2)
    beyond = math.sqrt(5) - 0.8
    assert score(scorer, observations) == pytest.approx([math.exp(-(beyond**2) / 8)], abs=1e-6)


def test_velocity_that_is_not_known():
    nan = math.nan
    observations = moving(
        [[0, 0], [2, 0], [0, 0], [0, 0]],
        [0.0, 2.0, 2.0, 2.0],
        [[1, 0], [nan] * 3, [nan] * 3, [0, 0]],
    )
    pairs = torch.tensor([[0, 0, 1, 1], [1, 2, 2, 3]])
    scorer = Proximity(scale=1.0, memory=math.inf, swerve=0.0)
    result = scorer(observations, pairs).tolist()
    away = math.exp(-2)  # 2 m, at a scale of 1 m
    # The first's velocity serves for the other: it brings it to (2, 0). At one time no velocity is
    # called for.
    assert result == pytest.approx([1, away, away, away], abs=1e-6)
    later = moving([[0, 0], [0, 0]], [0.0, 1.0], [[nan] * 3] * 2)
    assert score(scorer, later) == [0.5]
    with pytest.raises(KeyError, match="velocity"):
        score(scorer, seen([[0, 0, 0], [0, 0, 0]], [0.0, 1.0]))


def test_swerve_without_velocity_is_proximity():
    generator = torch.Generator().manual_seed(0)
    position = torch.randn(8, 3, generator=generator).tolist()
    still = moving(position, list(range(8)), [[0.0] * 3] * 8)
    there = score(Proximity(speed=0.3, swerve=2.0), still)
    assert there == pytest.approx(score(Proximity(speed=0.3), still), abs=1e-6)


def test_gradient_with_velocity():
    generator = torch.Generator().manual_seed(0)
    position, velocity = torch.randn(2, 4, 3, generator=generator, dtype=torch.float64)
    time = torch.tensor([0.0, 1.0, 2.0, 3.0], dtype=torch.float64)
    pairs = torch.triu_indices(4, 4, 1)
    scorer = Proximity(scale=2.0, speed=0.1, swerve=0.1)
    assert torch.autograd.gradcheck(
        lambda position, velocity: scorer.compare((3 * position, time, velocity), pairs),
        (position.requires_grad_(), velocity.requires_grad_()),
    )


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_gradient(speed):
    generator = torch.Generator().manual_seed(0)
    position = torch.randn(4, 3, generator=generator, dtype=torch.float64) * 3
    time = torch.tensor([0.0, 1.0, 2.0, 3.0], dtype=torch.float64)
    pairs = torch.triu_indices(4, 4, 1)
    scorer = Proximity(scale=2.0, speed=speed)
    assert torch.autograd.gradcheck(
        lambda position: scorer.compare((position, time), pairs), (position.requires_grad_(),)
    )


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"scale": 0.0}, "scale"),
        ({"memory": 0.0}, "memory"),
        ({"speed": -1.0}, "speed"),
        ({"swerve": -1.0}, "swerve"),
    ],
)
def test_refuses(arguments, name):
    with pytest.raises(ValueError, match=name):
        Proximity(**arguments)
