"""The better of two clusterings, part by part, against every way to mix them."""

import itertools

import numba
import numpy as np
import pytest

from mixer_torch.solvers.search import clustering, partition_crossover
from mixer_torch.solvers.search.clustering import build
from mixer_torch.solvers.search.partition_crossover import new_incumbent

TINY = 1e-9
inner_move, inner_crossover, inner_mark = (
    clustering.move,
    partition_crossover.partition_crossover,
    partition_crossover.mark_unchanged,
)


# what only kernels call has no way in from Python


@numba.njit
def move(state, i, c):
    inner_move(state, i, c)


@numba.njit
def crossover(state, best, changed, count, weight, tiny):
    return inner_crossover(state, best, changed, count, weight, tiny)


@numba.njit
def mark_unchanged(state, best, since):
    inner_mark(state, best, since)


def cost_of(weight, label):
    return float(weight[label[:, None] == label].sum() / 2)


def same_clusters(label, other):
    return ((label[:, None] == label) == (other[:, None] == other)).all()


def mixtures(one, other):
    """Each clustering that takes every component of "share a node" from the one or the other."""
    n = len(one)
    part = np.arange(n)
    while True:
        lowest = part.copy()
        for label in (one, other):
            for c in np.unique(label):
                lowest[label == c] = lowest[label == c].min()
        if (lowest == part).all():
            break
        part = lowest
    names = np.unique(part)
    for choice in itertools.product((False, True), repeat=len(names)):
        taken = np.isin(part, names[np.array(choice)])
        yield np.where(taken, one, other + n)


def problem(seed, n=12, views=4):
    """Costs, tokens of views, and two feasible labellings that differ in places."""
    rng = np.random.default_rng(seed)
    view = rng.integers(0, views, n)
    weight = np.triu(rng.normal(size=(n, n)), 1)
    weight = weight + weight.T
    weight[view[:, None] == view] = 0
    labels = []
    for _ in range(2):
        label = np.arange(n) if not labels else labels[0].copy()
        for i in rng.permutation(n)[: n if not labels else 4]:
            fits = [c for c in range(n) if not (view[(label == c)] == view[i]).any()]
            label[i] = rng.choice(fits) if fits else label[i]
        labels.append(label)
    return weight, np.arange(n + 1), view.astype(np.int32), *labels


@pytest.mark.parametrize("seed", range(40))
def test_the_best_mixture_is_kept_and_is_the_state(seed):
    weight, group_start, group, old, new = problem(seed)
    n = len(old)
    state = build(weight, group_start, group, old)
    best = new_incumbent(state, np.zeros(n))
    for i in np.flatnonzero(old != new):
        move(state, i, new[i])
    assert same_clusters(state.label, new)
    least = min(cost_of(weight, mixture) for mixture in mixtures(old, new))
    nodes = np.arange(n)
    change, worse = crossover(state, best, nodes, n, 0.5, TINY)
    assert cost_of(weight, best.label) == pytest.approx(least, abs=1e-9)
    assert change == pytest.approx(least - cost_of(weight, old), abs=1e-9)
    assert same_clusters(state.label, best.label)
    assert (worse > 0) == (least < cost_of(weight, new) - TINY)
    for c in np.unique(state.label):
        assert len(set(group[state.label == c])) == (state.label == c).sum()
        assert state.size[c] == (state.label == c).sum()
        expected = weight[:, state.label == c].sum(1)
        np.testing.assert_allclose(state.total[c], expected, atol=1e-12)
    np.testing.assert_allclose(best.cost, state.total[state.label, nodes], atol=1e-12)


def test_confirmed_are_clusters_that_came_back_and_starts_anew_where_the_cost_falls():
    weight = np.zeros((5, 5))
    weight[0, 1] = weight[1, 0] = weight[2, 3] = weight[3, 2] = -1.0
    state = build(weight, np.arange(6), np.arange(5, dtype=np.int32), np.array([0, 0, 1, 2, 3]))
    best = new_incumbent(state, np.full(5, 0.25))
    move(state, 3, 1)
    change, worse = crossover(state, best, np.arange(5), 4, 0.5, TINY)
    assert (change, worse) == (-1.0, 0)
    np.testing.assert_array_equal(best.confirmed, [0.75, 0.75, 0, 0, 0.25])


def test_clusters_that_came_back_count_as_at_rest():
    state = build(np.zeros((4, 4)), np.arange(5), np.arange(4, dtype=np.int32), np.zeros(4, int))
    move(state, 3, 1)
    best, since = new_incumbent(state, np.zeros(4)), state.number[1]
    move(state, 0, 2)
    move(state, 0, 0)
    mark_unchanged(state, best, since)
    assert (state.stamp[state.slot[: state.number[0]]] <= since).all()
    move(state, 0, 1)
    mark_unchanged(state, best, since)
    assert state.stamp[0] > since
    assert state.stamp[1] > since
