"""Lower bounds: never above the optimum that enumeration finds, and close to it."""

import time

import numpy as np
import pytest
import torch
from enumeration import clusterings, optimum, random_problem

import mixer_torch as mx
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers import bounds
from mixer_torch.solvers.bounds import lower_bound, split
from mixer_torch.solvers.problem import problem_of
from mixer_torch.solvers.proof.cuts import Cuts, PairVariables, separate
from mixer_torch.solvers.proof.dual_ascent import ascend
from mixer_torch.solvers.search.graph import Graph


def test_never_above_the_optimum_and_mostly_at_it():
    rng = np.random.default_rng(0)
    tight = 0
    for i in range(400):
        problem, cost, forbidden = random_problem(rng)
        bound, best = (
            lower_bound(problem, time_limit=[0.0, 1.0][i % 4 > 0]),
            optimum(cost, forbidden),
        )
        assert bound <= best
        tight += bound >= best - 0.05 * abs(best) - 1e-9
    assert tight > 270


def test_reduced_costs_tell_what_a_departure_costs():
    rng = np.random.default_rng(1)
    for _ in range(40):
        _, cost, forbidden = random_problem(rng, 6)
        scale = np.abs(cost).max() or 1.0
        ascent = ascend(cost / scale, forbidden, np.inf)
        for labels in clusterings(6):
            together = labels[:, None] == labels
            if (together & forbidden).any():
                continue
            value = (together * cost / scale).sum() / 2
            departs = together != (ascent.reduced < 0)
            departs[forbidden] = False
            loss = np.abs(ascent.reduced * departs).sum() / 2
            loss -= np.trace(np.abs(ascent.reduced * departs)) / 2
            assert value >= ascent.bound + loss - 1e-9


def test_every_clustering_fulfils_every_cut():
    rng = np.random.default_rng(2)
    labels = clusterings(7)
    together = (labels[:, :, None] == labels[:, None]).astype(float)
    variables = PairVariables(np.zeros((7, 7), bool))
    together = together[:, variables.first, variables.second]
    seen = 0
    for _ in range(30):
        x = rng.random((7, 7)) * (1 - np.eye(7))
        x = np.triu(x) + np.triu(x).T
        cuts = separate(x, 1e-6, 50, starts=7)
        rows = variables.rows(cuts)
        assert (together @ rows.T).max() <= 1
        assert rows @ variables.vector(x) - 1 == pytest.approx(cuts.violation)
        seen += len(cuts)
    assert seen > 100


def test_separation_misses_no_triangle():
    rng = np.random.default_rng(3)
    x = np.triu(rng.random((9, 9)).round(1), 1)
    x = x + x.T
    found = separate(x, 1e-6, 10**6)
    of_two = found.select(np.diff(found.start) == 2)
    keys = {
        (int(b), *sorted(of_two.member[s : s + 2].tolist()))
        for b, s in zip(of_two.centre, of_two.start, strict=False)
    }
    wanted = {
        (b, a, c)
        for b in range(9)
        for a in range(9)
        for c in range(a + 1, 9)
        if b not in (a, c) and x[a, b] + x[b, c] - x[a, c] > 1 + 1e-6
    }
    assert keys == wanted
    assert len(Cuts.none()) == 0


def test_solve_proves_a_bound_for_any_solver():
    affinity, _ = synthetic(views=5, noise=0.4, seed=3)
    assert mx.solve(affinity).gap is None
    answer = mx.solve(affinity, bound=True)
    exact = mx.solve(affinity, mx.Exact())
    assert answer.lower_bound <= exact.objective + 1e-6
    assert answer.gap < 0.05
    pair = mx.solve([affinity, affinity], bound=True)
    assert pair[0].lower_bound == pytest.approx(pair[1].lower_bound, rel=0.01)


def test_blocks_and_what_lies_between_bound_the_whole(monkeypatch):
    affinity, _ = synthetic(objects=6, views=8, noise=0.3, seed=5)
    problem = problem_of(affinity)
    best = mx.solve(affinity, mx.Exact()).objective
    whole = Graph.from_problem(problem)
    pieces, between = split(whole, 15)
    assert max(len(piece) for piece in pieces) <= 15
    assert sum(len(piece) for piece in pieces) == len(whole)
    inside = sum(np.minimum(piece.cost, 0).sum() / 2 for piece in pieces)
    assert inside + between == pytest.approx(np.minimum(whole.cost, 0).sum() / 2)
    monkeypatch.setattr(bounds, "BLOCK", 15)
    coarse = lower_bound(problem, time_limit=3)
    assert coarse <= best
    assert coarse > np.minimum(whole.cost, 0).sum() / 2


def test_time_is_kept_and_helps():
    affinity, _ = synthetic(objects=15, views=14, visible=0.7, noise=0.5, seed=6)
    best = mx.solve(affinity).objective
    start = time.perf_counter()
    little, more = (lower_bound(affinity, time_limit=limit) for limit in (0.05, 2.0))
    assert time.perf_counter() - start < 6
    assert little < more <= best + 1e-6


def test_nothing_to_bound():
    empty = mx.Affinity(
        torch.zeros(2, 0, dtype=torch.int64), torch.zeros(1, 0), torch.tensor([0, 0]), ("a",)
    )
    assert lower_bound(empty) == 0
    with pytest.raises(ValueError, match="time_limit: expected seconds >= 0, got -2"):
        lower_bound(empty, time_limit=-2)
