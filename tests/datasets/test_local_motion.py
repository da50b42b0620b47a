"""Local motion: straight paths come back, and what cannot be told is left as measured."""

import numpy as np
import pytest

from mixer_torch.datasets.local_motion import chains, local_motion

RATE = 10.0


def walk(frames, start, velocity, corner=(100.0, 100.0)):
    """Frames, boxes and places of someone who walks straight; boxes move by 2 pixels a frame."""
    frames = np.array(frames)
    time = frames[:, None] / RATE
    low = np.array(corner) + 2 * frames[:, None]
    return frames, np.concatenate([low, low + np.array([40.0, 90.0])], 1), start + time * velocity


def test_straight_path_comes_back():
    frame, box, place = walk(range(21), np.array([1.0, 2.0]), np.array([0.5, -1.5]))
    place += np.random.default_rng(0).normal(0, 0.05, place.shape)
    rows = np.array([0, 10, 20])
    position, velocity = local_motion(frame, box, place, rows, RATE, 1.0)
    for k, row in enumerate(rows):
        near = np.abs(frame - frame[row]) <= 10
        time = (frame[near] - frame[row]) / RATE
        fits = [np.polyfit(time, place[near, axis], 1) for axis in (0, 1)]
        np.testing.assert_allclose(velocity[k], [slope for slope, _ in fits], atol=1e-9)
        np.testing.assert_allclose(position[k], [value for _, value in fits], atol=1e-9)
    np.testing.assert_allclose(velocity[1], [0.5, -1.5], atol=0.1)


def test_two_who_are_apart_are_not_mixed():
    a = walk(range(11), np.array([0.0, 0.0]), np.array([1.0, 0.0]))
    b = walk(range(11), np.array([9.0, 0.0]), np.array([-1.0, 0.0]), corner=(100.0, 300.0))
    frame, box, place = (np.concatenate(parts) for parts in zip(a, b, strict=True))
    order = np.random.default_rng(0).permutation(len(frame))
    rows = np.argsort(order)[[5, 16]]
    position, velocity = local_motion(frame[order], box[order], place[order], rows, RATE, 0.5)
    np.testing.assert_allclose(velocity, [[1, 0], [-1, 0]], atol=1e-9)
    np.testing.assert_allclose(position, place[[5, 16]], atol=1e-9)


@pytest.mark.parametrize(("missing", "whole"), [((5,), True), ((5, 6), True), ((5, 6, 7), False)])
def test_a_chain_bridges_two_frames(missing, whole):
    frames = [k for k in range(13) if k not in missing]
    frame, box, place = walk(frames, np.zeros(2), np.ones(2))
    before, after = chains(frame, box)
    assert (after[4] == 5) == whole
    assert (before[5] == 4) == whole
    assert after[-1] == before[0] == -1
    position, velocity = local_motion(frame, box, place, np.array([4]), RATE, 2.0)
    assert np.isnan(velocity).all()  # less than 2 s
    np.testing.assert_allclose(position, place[[4]])


def test_places_that_are_not_known_are_left_out():
    frame, box, place = walk(range(11), np.zeros(2), np.ones(2))
    place[3] = np.nan
    given = place.copy()
    position, velocity = local_motion(frame, box, place, np.array([3, 5]), RATE, 0.5)
    np.testing.assert_allclose(velocity, 1, atol=1e-9)
    np.testing.assert_allclose(position[0], [0.3, 0.3], atol=1e-9)
    np.testing.assert_array_equal(place, given)


def test_nothing_to_see():
    none = np.empty(0, dtype=np.int64)
    position, velocity = local_motion(none, np.empty((0, 4)), np.empty((0, 2)), none, RATE, 0.5)
    assert position.shape == velocity.shape == (0, 2)
