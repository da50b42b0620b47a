"""The compiled filter against the matrices of the textbook."""

from itertools import pairwise

import numpy as np
import pytest

from mixer_torch.tracking.kalman import filter_each


def by_matrices(indices, position, variance, time, q, flat):
    """One axis, one observation: predict and update with 2 x 2 matrices."""
    first = indices[0]
    mean, spread = np.array([position[first], 0.0]), np.diag([variance[first], flat])
    for before, now in pairwise(indices):
        dt = time[now] - time[before]
        move = np.array([[1, dt], [0, 1]])
        far = abs(dt)
        noise = q * np.array([[far**3 / 3, dt * far / 2], [dt * far / 2, far]])
        mean, spread = move @ mean, move @ spread @ move.T + noise
        gain = spread[:, 0] / (spread[0, 0] + variance[now])
        mean = mean + gain * (position[now] - mean[0])
        spread = spread - np.outer(gain, spread[0])
    return [*mean, spread[0, 0], spread[0, 1], spread[1, 1]]


@pytest.mark.parametrize("backwards", [False, True])
def test_matrices(backwards):
    rng = np.random.default_rng(0)
    m, axes, memory = 8, 2, 4
    time = np.sort(rng.uniform(0, 3, m)) * (-1 if backwards else 1)
    position, variance = rng.normal(size=(m, axes)), rng.uniform(0.1, 1, (m, axes))
    jolt, flat = rng.uniform(0.1, 1, (m, axes)), rng.uniform(1, 9, (m, axes))
    before = np.full((m, memory), -1)
    for i in range(m):
        count = min(i, int(rng.integers(0, memory + 1)))
        before[i, :count] = np.sort(rng.choice(i, count, replace=False))[::-1]
    found = filter_each(before, position, variance, time, jolt, flat)
    assert found.shape == (m, axes, 5)
    for i in range(m):
        indices = [*before[i][before[i] >= 0][::-1], i]
        for a in range(axes):
            expected = by_matrices(
                indices, position[:, a], variance[:, a], time, jolt[i, a], flat[i, a]
            )
            assert found[i, a] == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_alone_is_what_was_measured():
    one = np.ones((1, 3))
    found = filter_each(np.empty((1, 0), np.int64), 5 * one, 2 * one, np.zeros(1), one, 7 * one)
    assert found[0].tolist() == [[5, 0, 2, 0, 7]] * 3


def test_nothing():
    none = np.empty((0, 3))
    assert filter_each(np.empty((0, 4), np.int64), none, none, none[:, 0], none, none).shape == (
        0, 3, 5,
    )  # fmt: skip
