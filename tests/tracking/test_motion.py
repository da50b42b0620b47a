"""Motion: filter against least squares, likelihood ratios against full Gaussians."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from mixer_torch.tracking.motion import (
    MotionModel,
    State,
    axis_scale,
    box_position,
    filtered,
    first_state,
    history,
    log_ratio,
    measured,
    resolution,
)

STILL = (1e-9, 1e-9, 1e-9)


def random_state(n, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, 3, 2, 2))
    spread = root @ root.swapaxes(-1, -2) + 0.1 * np.eye(2)
    packed = np.stack([spread[..., 0, 0], spread[..., 0, 1], spread[..., 1, 1]], -1)
    return State(torch.tensor(rng.normal(size=(n, 3, 2))), torch.tensor(packed)), spread


def test_history_is_what_a_loop_finds():
    rng = np.random.default_rng(0)
    label, time = rng.integers(0, 4, 30), rng.permutation(30) / 10
    found = history(torch.tensor(label), torch.tensor(time), 3)
    for i in range(30):
        before = [j for j in range(30) if label[j] == label[i] and time[j] < time[i]]
        expected = sorted(before, key=lambda j: -time[j])[:3]
        assert found[i].tolist() == expected + [-1] * (3 - len(expected))


@pytest.mark.parametrize("seconds", [0.7, -0.7])
def test_moved_is_the_matrices_of_the_textbook(seconds):
    state, spread = random_state(4, 1)
    noise = torch.rand(4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    moved = state.moved(torch.full((4,), seconds, dtype=torch.float64), noise)
    step, far = np.array([[1, seconds], [0, 1]]), abs(seconds)
    jolt = np.array([[far**3 / 3, seconds * far / 2], [seconds * far / 2, far]])
    expected = step @ spread @ step.T + noise.numpy()[..., None, None] * jolt
    assert moved.spread[..., 0].numpy() == pytest.approx(expected[..., 0, 0])
    assert moved.spread[..., 1].numpy() == pytest.approx(expected[..., 0, 1])
    assert moved.spread[..., 2].numpy() == pytest.approx(expected[..., 1, 1])
    assert moved.mean.numpy() == pytest.approx((step @ state.mean.numpy()[..., None])[..., 0])


def test_measuring_and_slowing_are_products_of_gaussians():
    state, spread = random_state(3, 2)
    position = torch.randn(3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    variance = torch.full((3, 3), 0.3, dtype=torch.float64)
    for after, axis, value in (
        (state.seen(position, variance), 0, position.numpy()),
        (state.slowed(variance), 1, np.zeros((3, 3))),
    ):
        information = np.linalg.inv(spread)
        told = np.zeros((2, 2))
        told[axis, axis] = 1 / 0.3
        posterior = np.linalg.inv(information + told)
        weighted = (information @ state.mean.numpy()[..., None])[..., 0]
        weighted[..., axis] += value / 0.3
        mean = (posterior @ weighted[..., None])[..., 0]
        assert after.mean.numpy() == pytest.approx(mean)
        assert after.spread[..., 0].numpy() == pytest.approx(posterior[..., 0, 0])
        assert after.spread[..., 1].numpy() == pytest.approx(posterior[..., 0, 1])
        assert after.spread[..., 2].numpy() == pytest.approx(posterior[..., 1, 1])


@pytest.mark.parametrize("backwards", [False, True])
def test_velocities_are_those_of_weighted_least_squares(backwards):
    rng = np.random.default_rng(3)
    time = np.sort(rng.uniform(0, 2, 9))
    height = rng.uniform(50, 60, 9)
    position = np.stack([100 + 40 * time, 50 - 10 * time, 4 + 0.1 * time], 1)
    position += rng.normal(size=(9, 3)) * [2, 2, 0.05]
    model = MotionModel(jolt=STILL)
    state = filtered(
        torch.tensor(position),
        torch.tensor(height),
        torch.tensor(time),
        torch.zeros(9, dtype=torch.int64),
        model,
        2.0,
        memory=20,
        backwards=backwards,
    )
    i = 3
    used = slice(i, 9) if backwards else slice(0, i + 1)
    variance = measured(torch.tensor(height), model, 2.0).numpy()
    for axis in range(3):
        design = np.stack([np.ones(9), time - time[i]], 1)[used]
        weight = 1 / variance[used, axis]
        normal = design.T * weight @ design
        line = np.linalg.solve(normal, design.T * weight @ position[used, axis])
        spread = np.linalg.inv(normal)
        assert state.mean[i, axis].numpy() == pytest.approx(line, rel=1e-2, abs=1e-3)
        assert state.spread[i, axis, 2].item() == pytest.approx(spread[1, 1], rel=2e-2)


def test_log_ratio_is_that_of_full_gaussians():
    model = MotionModel()
    earlier, spread_a = random_state(5, 4)
    later, spread_b = random_state(5, 5)
    height, seconds = torch.full((5,), 2.0).double(), torch.full((5,), 0.4).double()
    found = log_ratio(earlier, later, seconds, height, model)
    step, unit = np.array([[1, 0.4], [0, 1]]), axis_scale(height).numpy()
    for n in range(5):
        for axis in range(3):
            speed = (model.speed[axis] * unit[n, axis]) ** 2
            jolt = (model.jolt[axis] * unit[n, axis]) ** 2
            information = np.linalg.inv(spread_a[n, axis])
            posterior = np.linalg.inv(information + np.diag([0, 1 / speed]))
            mean = posterior @ information @ earlier.mean[n, axis].numpy()
            noise = jolt * np.array([[0.4**3 / 3, 0.08], [0.08, 0.4]])
            total = step @ posterior @ step.T + noise + spread_b[n, axis]
            same = multivariate_normal(step @ mean, total).logpdf(later.mean[n, axis].numpy())
            stranger = multivariate_normal(0, spread_b[n, axis, 1, 1] + speed).logpdf(
                later.mean[n, axis, 1].item()
            )
            expected = same - stranger + math.log(unit[n, axis])
            assert found[n, axis].item() == pytest.approx(expected, abs=1e-6)


def test_log_ratio_is_the_same_in_a_mirror_of_time():
    model, height = MotionModel(), torch.tensor([40.0]).double()
    a, b = (
        first_state(torch.tensor([[x, 0.0, 3.7]]).double(), height, model, 2.0)
        for x in (10.0, 30.0)
    )
    seconds = torch.tensor([0.5]).double()
    forwards, backwards = (log_ratio(x, y, seconds, height, model) for x, y in ((a, b), (b, a)))
    assert forwards.numpy() == pytest.approx(backwards.numpy(), rel=1e-6)


@pytest.mark.parametrize("planted", [1.0, 3.0])
def test_resolution_is_the_planted_error(planted):
    rng = np.random.default_rng(0)
    label = np.repeat(np.arange(20), 100)
    time = np.tile(np.arange(100) / 25, 20)
    x = 300 * np.sin(label) + 50 * time + rng.normal(size=2000) * planted
    position = np.stack([x, np.zeros(2000), np.full(2000, 3.0)], 1)
    height = torch.full((2000,), 20.0).double()
    arrays = (torch.tensor(position), height, torch.tensor(time), torch.tensor(label))
    assert resolution(*arrays, MotionModel()) == pytest.approx(planted, rel=0.1)


def test_resolution_without_triples_is_a_share_of_the_height():
    one = torch.zeros(1, dtype=torch.int64)
    position, height = box_position(torch.tensor([[0.0, 0, 10, 100]]))
    assert resolution(position, height, one.double(), one, MotionModel()) == pytest.approx(3.0)
    assert resolution(position[:0], height[:0], one[:0].double(), one[:0], MotionModel()) == 1.0


@pytest.mark.parametrize("name", ["error", "blur", "speed", "jolt"])
@pytest.mark.parametrize("value", [(1.0, 0.0, 1.0), (1.0, 1.0, float("inf"))])
def test_models_have_positive_numbers(name, value):
    with pytest.raises(ValueError, match=name):
        MotionModel(**{name: value})
