"""Tracks while they are followed: lines against NumPy's, and each hypothesis by hand."""

import numpy as np
import pytest

from mixer_torch.tracking.states import HYPOTHESES, MEMORY, States, predicted, trend


def followed(boxes, frames):
    """One track that was seen in these boxes."""
    zero = np.zeros(1)
    first = np.array([0])
    states = States.none().started(first, boxes[:1], frames[0], zero, first, first)
    for row, (box, frame) in enumerate(zip(boxes[1:], frames[1:], strict=True), 1):
        states.observed(first, np.array([row]), box[None], frame, zero)
    return states


@pytest.mark.parametrize("most", [2, 4, 10])
@pytest.mark.parametrize("count", [2, 5, 12, 15])
def test_lines_are_those_of_numpy(count, most):
    rng = np.random.default_rng(count)
    boxes = np.column_stack([rng.normal(size=(count, 2)), rng.uniform(1, 2, (count, 2))])
    frames = np.cumsum(rng.integers(1, 4, count)).astype(float)
    states = followed(boxes, frames)
    slope, now = trend(states.history, states.count, states.history[:, :, :2], most)
    used = min(count, most, MEMORY)
    for axis in range(2):
        wanted = np.polyfit(frames[-used:] - frames[-1], boxes[-used:, axis], 1)
        assert (slope[0, axis], now[0, axis]) == pytest.approx(tuple(wanted), abs=1e-9)


def test_hypotheses_of_a_steady_motion_agree_but_for_rest():
    frames = np.arange(12.0)
    boxes = np.column_stack([2 * frames, -frames, np.full(12, 3.0), np.full(12, 4.0)])
    found, velocity = predicted(followed(boxes, frames), 14.0)
    assert len(HYPOTHESES) == found.shape[1] == 4
    assert found[0, 0] == pytest.approx([22, -11, 3, 4])
    for k in (1, 2, 3):
        assert found[0, k] == pytest.approx([28, -14, 3, 4])
    assert velocity[0] == pytest.approx([2, -1])


def test_who_was_seen_once_is_where_it_was():
    found, velocity = predicted(followed(np.array([[1.0, 2, 3, 4]]), [0.0]), 5.0)
    assert found[0] == pytest.approx(np.tile([1, 2, 3, 4], (4, 1)))
    assert velocity[0] == pytest.approx([0, 0])


def test_each_may_be_asked_for_at_a_frame_of_its_own():
    frames = np.arange(5.0)
    boxes = np.column_stack([frames, frames, np.ones(5), np.ones(5)])
    one = followed(boxes, frames)
    both = one.select(np.array([0, 0]))
    found, _ = predicted(both, np.array([5.0, 8.0]))
    assert found[0] == pytest.approx(predicted(one, 5.0)[0][0])
    assert found[1] == pytest.approx(predicted(one, 8.0)[0][0])


def test_states_follow_the_camera():
    states = followed(np.array([[1.0, 2, 3, 4]]), [0.0])
    states.moved(np.array([2.0, 10.0, 20.0]))
    assert states.history[0, -1].tolist() == [12, 24, 6, 8, 0]
