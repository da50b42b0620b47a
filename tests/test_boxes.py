"""Overlap of boxes against a grid of pixels, and their assignment against brute force."""

import itertools

import numpy as np
import pytest

from mixer_torch.boxes import iou, match_boxes


def random_boxes(generator, count):
    low = generator.uniform(0, 6, (count, 2))
    return np.concatenate([low, low + generator.uniform(2, 8, (count, 2))], 1)


def test_overlap_against_a_grid_of_pixels():
    generator = np.random.default_rng(0)
    a, b = (np.rint(random_boxes(generator, 6)) for _ in range(2))
    grid = np.stack(np.meshgrid(np.arange(20) + 0.5, np.arange(20) + 0.5), -1)

    def mask(box):
        return ((grid > box[:2]) & (grid < box[2:])).all(-1)

    for i, j in itertools.product(range(6), repeat=2):
        expected = (mask(a[i]) & mask(b[j])).sum() / (mask(a[i]) | mask(b[j])).sum()
        assert iou(a, b)[i, j] == pytest.approx(expected)


@pytest.mark.parametrize("seed", range(10))
def test_matching_against_brute_force(seed):
    generator = np.random.default_rng(seed)
    a, b = random_boxes(generator, 4), random_boxes(generator, 5)
    overlap = iou(a, b)
    overlap[overlap < 0.3] = 0
    best = max(
        sum(overlap[i, j] for i, j in enumerate(order))
        for order in itertools.permutations(range(5), 4)
    )
    mine, theirs = match_boxes(np.ones(4), a, np.ones(5), b, 0.3)
    assert overlap[mine, theirs].sum() == pytest.approx(best)
    assert (overlap[mine, theirs] >= 0.3).all()
    assert len(set(mine)) == len(mine)
    assert len(set(theirs)) == len(theirs)


def test_matching_stays_within_frames():
    box = np.array([[0.0, 0, 10, 10]])
    mine, theirs = match_boxes(np.array([1.0]), box, np.array([2.0]), box)
    assert len(mine) == len(theirs) == 0


def test_greedy_matching_would_lose_one():
    # The middle truth overlaps both detections; only one assignment serves both.
    detections = np.array([[0.0, 0, 10, 10], [4, 0, 14, 10]])
    truth = np.array([[2.0, 0, 12, 10], [-2, 0, 8, 10]])
    mine, theirs = match_boxes(np.ones(2), detections, np.ones(2), truth, 0.5)
    assert dict(zip(mine.tolist(), theirs.tolist(), strict=True)) == {0: 1, 1: 0}
