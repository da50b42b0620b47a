"""The integer program: against enumeration, a solver of a naive formulation, and a clock."""

import time

import numpy as np
import pytest
import torch
from enumeration import optimum, random_problem
from scipy.optimize import Bounds, LinearConstraint, milp

import mixer_torch as mx
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers import exact
from mixer_torch.solvers.exact import Exact
from mixer_torch.solvers.problem import Problem, is_distinct, objective_of, problem_of
from mixer_torch.solvers.proof.branching import granularity


def naive(cost, forbidden):
    """The optimum by all triangle inequalities at once."""
    n = len(cost)
    first, second = np.triu_indices(n, 1)
    number = np.zeros((n, n), np.int64)
    number[first, second] = number[second, first] = np.arange(len(first))
    rows = []
    for b in range(n):
        for a in range(n):
            for c in range(a + 1, n):
                if b not in (a, c):
                    row = np.zeros(len(first))
                    row[[number[a, b], number[b, c]]] = 1
                    row[number[a, c]] = -1
                    rows.append(row)
    result = milp(
        cost[first, second],
        constraints=LinearConstraint(np.array(rows), ub=1),
        integrality=np.ones(len(first)),
        bounds=Bounds(0, 1 - forbidden[first, second].astype(float)),
        options={"mip_rel_gap": 0},
    )
    assert result.success
    return result.fun


def agrees(solution, problem, best, size):
    labels = solution.labels
    assert solution.status is mx.Status.OPTIMAL
    assert is_distinct(labels, problem.view)
    assert objective_of(problem, labels) == pytest.approx(best, rel=1e-6, abs=1e-7 * size)
    assert solution.lower_bound <= best + 1e-9 * size
    assert solution.lower_bound == pytest.approx(best, rel=1e-6, abs=1e-6 * size)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_enumeration_finds_nothing_better(dtype):
    rng = np.random.default_rng(0)
    for _ in range(80):
        problem, cost, forbidden = random_problem(rng, dtype=dtype)
        solution = Exact().run(problem)
        agrees(solution, problem, optimum(cost, forbidden), np.abs(cost).max(initial=0) or 1)


def test_a_generic_solver_of_the_naive_formulation_finds_nothing_better():
    rng = np.random.default_rng(1)
    for m in (12, 14):
        problem, cost, forbidden = random_problem(rng, m)
        agrees(Exact().run(problem), problem, naive(cost, forbidden), np.abs(cost).max())


def test_a_search_that_starts_from_nothing_and_has_to_branch_is_right():
    rng = np.random.default_rng(3)
    nodes = 0
    for _ in range(3):
        cost = rng.choice([-1.0, 1.0], size=(13, 13))
        cost = np.triu(cost, 1) + np.triu(cost, 1).T
        pairs = torch.triu_indices(13, 13, 1)
        value = torch.as_tensor(cost)[pairs[0], pairs[1]] + 1e-3 * torch.randn(
            pairs.shape[1], generator=torch.Generator().manual_seed(0), dtype=torch.float64
        )
        cost[pairs[0], pairs[1]] = cost[pairs[1], pairs[0]] = value.numpy()
        problem = Problem(pairs, value, torch.arange(13), torch.full_like(value, 0.5))
        solution = Exact(start=mx.Mixer(refine=False)).run(problem)
        agrees(solution, problem, naive(cost, np.zeros((13, 13), bool)), 1)
        nodes += solution.stats["nodes"]
    assert nodes > 0


def test_what_time_allows_is_feasible_and_its_bound_holds():
    affinity, _ = synthetic(objects=12, views=14, visible=0.8, noise=0.8, wrong=0.3, seed=4)
    best = mx.solve(affinity)
    mx.solve(affinity, Exact(time_limit=0.1))  # compiled, whatever that takes
    for limit in (0.0, 0.3):
        start = time.perf_counter()
        answer = mx.solve(affinity, Exact(time_limit=limit))
        assert time.perf_counter() - start < limit + 5
        assert answer.status is mx.Status.TIME_LIMIT
        assert answer.lower_bound < best.objective
        assert answer.objective <= 0
        assert answer.gap > 0


def test_components_are_proven_apart_and_add_up():
    first, _ = synthetic(objects=4, views=4, seed=0, dtype=torch.float64)
    second, _ = synthetic(objects=4, views=4, seed=1, dtype=torch.float64)
    m = len(first)
    views = torch.cat([first.view, second.view])
    both = mx.Affinity(
        torch.cat([first.pairs, second.pairs + m], 1),
        torch.cat([first.scores, second.scores], 1),
        views,
        first.modalities,
    )
    one, two = (mx.solve(part, Exact()).objective for part in (first, second))
    together = mx.solve(both, Exact())
    assert together.objective == pytest.approx(one + two)
    assert together.lower_bound == pytest.approx(one + two, rel=1e-6)
    assert together.gap < 1e-6


def test_table_one_sizes_are_proven_and_no_solver_beats_them():
    for views in (2, 6, 12):
        affinity, _ = synthetic(views=views, visible=0.4, outliers=0.3, seed=views)
        answer = mx.solve(affinity, Exact(time_limit=30))
        assert answer.status is mx.Status.OPTIMAL
        assert answer.objective <= mx.solve(affinity).objective + 1e-6
        assert answer.gap < 1e-6


def test_same_problem_same_labels():
    problem = problem_of(synthetic(views=6, noise=0.5, seed=2)[0])
    assert torch.equal(Exact().run(problem).labels, Exact().run(problem).labels)


@pytest.mark.parametrize("value", [0.0, -1.0, 1.0])
def test_ties_of_all_costs(value):
    pairs = torch.triu_indices(6, 6, 1)
    cost = torch.full((15,), value)
    problem = Problem(pairs, cost, torch.arange(6), torch.full_like(cost, 0.5))
    solution = Exact().run(problem)
    assert solution.status is mx.Status.OPTIMAL
    assert objective_of(problem, solution.labels) == min(15 * value, 0)
    assert solution.lower_bound == pytest.approx(min(15 * value, 0))


def test_costs_that_are_multiples_of_a_number_are_told():
    assert granularity(np.array([2.0, -4.0, 0.0])) == 2
    assert granularity(np.array([0.75, -0.5])) == 0.25
    assert granularity(np.array([0.1, 0.25])) == 0
    assert granularity(np.zeros(3)) == 0


def test_arguments_are_checked():
    with pytest.raises(ValueError, match="time_limit: expected seconds >= 0, got -1"):
        Exact(time_limit=-1)


def test_a_part_too_large_for_a_program_is_bounded_without_one(monkeypatch):
    """Two thousand nodes in a ring that all attract: one part, and too many pairs for a matrix."""
    m = 2000
    first = torch.arange(m)
    pairs = torch.stack([first, (first + 1) % m]).sort(0).values
    cost = torch.full((m,), -1.0)
    problem = Problem(pairs, cost, torch.arange(m), torch.full_like(cost, 0.5))
    monkeypatch.setattr(exact, "BranchAndCut", None)  # an error where it is called
    solution = Exact(time_limit=5).run(problem)
    assert solution.status is mx.Status.OPTIMAL
    assert objective_of(problem, solution.labels) == -m
    assert solution.lower_bound == pytest.approx(-m)


def test_the_start_has_half_of_the_time_and_the_search_ends_with_it(monkeypatch):
    limits, deadlines = [], []

    class Start(mx.Mixer):
        def __init__(self, time_limit):
            limits.append(time_limit)
            super().__init__(time_limit=time_limit)

    def prove(part, labels, deadline):
        deadlines.append(deadline)
        return original(part, labels, deadline)

    original = exact.prove
    monkeypatch.setattr(exact, "Mixer", Start)
    monkeypatch.setattr(exact, "prove", prove)
    cost = torch.randn(200 * 199 // 2, generator=torch.Generator().manual_seed(0))
    pairs = torch.triu_indices(200, 200, 1)
    problem = Problem(pairs, cost, torch.arange(200), torch.full_like(cost, 0.5))
    before = time.perf_counter()
    solution = Exact(time_limit=1).run(problem)
    assert limits == [0.5]
    assert deadlines
    assert all(deadline < before + 1.1 for deadline in deadlines)  # set before anything is run
    assert objective_of(problem, solution.labels) < 0
    assert solution.lower_bound < objective_of(problem, solution.labels)
