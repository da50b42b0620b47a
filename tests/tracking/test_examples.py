"""Labelled sequences to learn from: what is made harder keeps what it should keep."""

import numpy as np
import pytest

from mixer_torch.datasets.simulated import Scene, Simulated
from mixer_torch.tracking.examples import LONGEST_RUN, Table, _table, examples, simulated

SCENE = Scene(frames=120, things=8, clutter=0.5)


@pytest.fixture(scope="module")
def table():
    return _table(Simulated(SCENE, 0).load())


def rng(seed=0):
    return np.random.default_rng(seed)


def test_the_first_variant_is_the_sequence_as_it_is(table):
    found = examples(Simulated(SCENE, 0).load(), variants=1, rows=10_000)
    assert len(found) == 1
    assert (found[0].identity == table.identity).all()
    assert found[0].frame_rate == pytest.approx(25)
    assert len(found[0].description) == len(table.frame) == len(found[0].sequence.box)


@pytest.mark.parametrize("rows", [50, 300])
def test_a_stretch_is_of_whole_frames_in_a_row(table, rows):
    part = table.stretch(rows, rng())
    frames = np.unique(part.frame)
    assert (np.diff(frames) == 1).all()
    whole = np.isin(table.frame, frames)
    assert (part.corners == table.corners[whole]).all()
    assert rows <= len(part.frame) <= rows + 30


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_every_so_many_frames_are_numbered_anew(table, stride):
    part = table.every(stride)
    assert part.frame[0] == 0
    frames = table.frame[0] + stride * part.frame
    assert set(np.unique(frames)) <= set(np.unique(table.frame))
    assert len(part.frame) == np.isin(table.frame, frames).sum()


def test_noise_has_the_size_that_is_asked_for_and_boxes_stay_boxes(table):
    moved = table.noisy(0.05, rng())
    side = table.corners[:, 2:] - table.corners[:, :2]
    error = (moved.corners - table.corners) / side.min(1)[:, None]
    assert error.std() == pytest.approx(0.05, rel=0.05)
    assert (moved.corners[:, 2:] > moved.corners[:, :2]).all()
    assert (table.noisy(0.0, rng()).corners == table.corners).all()


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_gaps_take_about_the_share_and_some_are_long(table, share):
    left = [len(table.gappy(share, rng(seed)).frame) / len(table.frame) for seed in range(10)]
    assert 1 - 1.8 * share < np.mean(left) < 1 - 0.5 * share
    part = table.gappy(share, rng(1))
    longest = 0
    for who in np.unique(part.identity[part.identity >= 0]):
        gaps = np.diff(np.sort(part.frame[part.identity == who]))
        longest = max(longest, int(gaps.max(initial=0)))
    assert 5 < longest <= 3 * LONGEST_RUN
    assert len(table.gappy(0.0, rng()).frame) == len(table.frame)


def test_the_same_seed_gives_the_same_examples():
    seen = Simulated(SCENE, 0).load()
    a, b = (examples(seen, seed=3) for _ in range(2))
    assert len(a) == 2
    for one, other in zip(a, b, strict=True):
        assert (one.sequence.box == other.sequence.box).all()
        assert (one.description == other.description).all()


def test_simulated_scenes_are_all_different():
    found = simulated(4, seed=5, rows=200)
    assert len({len(one.identity) for one in found}) > 1
    assert all(len(one.identity) == len(one.sequence.box) > 0 for one in found)


def test_nothing_seen_is_no_example():
    seen = Simulated(SCENE, 0).load()
    assert examples(seen.select(seen["frame"] < 0)) == []
    empty = Table(*(np.zeros(0),) * 2, np.zeros((0, 4)), *(np.zeros(0),) * 2)
    assert len(empty.stretch(10, rng()).frame) == 0
