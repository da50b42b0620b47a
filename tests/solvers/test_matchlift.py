"""MatchLift's program against a generic solver, weak duality and closed forms."""

import numpy as np
import pytest
import torch
from scipy.optimize import minimize

import mixer_torch as mx
from mixer_torch.solvers.matchlift import (
    MatchLift,
    dual_bound,
    lift,
    map_density,
    positive_part,
    solve_program,
)
from mixer_torch.solvers.problem import is_distinct, objective_of, problem_of


def random_program(seed, m=6, views=3, size=4):
    generator = torch.Generator().manual_seed(seed)
    cost = torch.rand(m, m, generator=generator, dtype=torch.float64) - 0.5
    view = torch.arange(m) % views
    return lift((cost + cost.T) / 2, view, size), (cost + cost.T) / 2, view, size


def generic_optimum(cost, view, size):
    """The published program over X = V Vᵀ, by sequential quadratic programming from scipy.

    V is square, so every positive semidefinite matrix can be reached.
    """
    cost, view = cost.numpy(), view.numpy()
    m = len(view)
    free = view[:, None] != view
    target = np.eye(m + 1)
    target[0, 0], target[0, 1:] = size, 1
    fixed = np.zeros((m + 1, m + 1), dtype=bool)
    fixed[0], fixed[1:, 1:] = True, ~free
    fixed, open_ = np.triu(fixed), np.triu(~fixed & ~fixed.T)
    full = np.zeros((m + 1, m + 1))
    full[1:, 1:] = np.where(free, cost, 0)

    def gram(v):
        square = v.reshape(m + 1, m + 1)
        return square @ square.T

    def jacobian(v, mask):
        square = v.reshape(m + 1, m + 1)
        rows = []
        for a, b in np.argwhere(mask):
            row = np.zeros_like(square)
            row[a] += square[b]
            row[b] += square[a]
            rows.append(row.ravel())
        return np.array(rows)

    start = np.random.default_rng(0).normal(size=(m + 1, m + 1)).ravel()
    result = minimize(
        lambda v: (full * gram(v)).sum(),
        start,
        jac=lambda v: (2 * full @ v.reshape(m + 1, m + 1)).ravel(),
        method="SLSQP",
        constraints=[
            {
                "type": "eq",
                "fun": lambda v: (gram(v) - target)[fixed],
                "jac": lambda v: jacobian(v, fixed),
            },
            {"type": "ineq", "fun": lambda v: gram(v)[open_], "jac": lambda v: jacobian(v, open_)},
        ],
        options={"maxiter": 500, "ftol": 1e-10},
    )
    assert result.success
    return result.fun


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("size", [3, 5])
def test_objective_of_a_generic_convex_solver(seed, size):
    program, cost, view, _ = random_program(seed, size=size)
    point = solve_program(program, max_iterations=5000, tolerance=1e-7)
    assert point.iterations < 5000
    ours = float((program.cost * point.primal).sum())
    assert ours == pytest.approx(generic_optimum(cost, view, size), abs=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_optimality_is_certified_by_weak_duality(seed):
    program, cost, view, size = random_program(seed, m=20, views=5, size=7)
    point = solve_program(program, max_iterations=5000, tolerance=1e-7)
    primal, dual = point.primal.numpy(), point.dual.numpy()
    matrix = primal.copy()  # undo the scaling of the first row, to the published form
    matrix[0] *= size**0.5
    matrix[:, 0] *= size**0.5
    assert matrix[0, 0] == pytest.approx(size)
    np.testing.assert_allclose(matrix[0, 1:], 1)
    inside = matrix[1:, 1:]
    same_view = (view[:, None] == view).numpy()
    np.testing.assert_allclose(inside[same_view], np.eye(20)[same_view])
    assert inside.min() >= 0
    assert np.linalg.eigvalsh(matrix)[0] > -1e-5
    assert np.linalg.eigvalsh(dual)[0] > -1e-9
    objective = (np.where(same_view, 0, cost.numpy()) * inside).sum()
    bound = dual_bound(program, point.dual)
    assert bound <= objective + 1e-9
    assert bound == pytest.approx(objective, abs=1e-4)


def test_bound_holds_for_any_dual():
    program, _, _, _ = random_program(0)
    optimum = dual_bound(program, solve_program(program, 5000, 1e-7).dual)
    for seed in range(5):
        root = torch.randn(7, 7, generator=torch.Generator().manual_seed(seed)).double()
        assert dual_bound(program, 0.1 * root @ root.T) <= optimum + 1e-4


def test_projection_on_the_cone():
    matrix = torch.randn(8, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    matrix = matrix + matrix.T
    positive = positive_part(matrix)
    rest = matrix - positive
    assert float(torch.linalg.eigvalsh(positive)[0]) > -1e-12
    assert float(torch.linalg.eigvalsh(rest)[-1]) < 1e-12
    assert abs(float((positive * rest).sum())) < 1e-10  # Moreau: the parts are orthogonal
    torch.testing.assert_close(positive_part(positive), positive)


@pytest.mark.parametrize(("size", "cost", "expected"), [(2, 1, 0), (2, -1, 1), (1, 1, 1)])
def test_two_observations_in_closed_form(size, cost, expected):
    # X − 11ᵀ / k ⪰ 0 leaves X_01 free in [0, 1] for k = 2, and forces it to 1 for k = 1.
    costs = torch.tensor([[0.0, cost], [cost, 0.0]], dtype=torch.float64)
    program = lift(costs, torch.tensor([0, 1]), size)
    point = solve_program(program, 5000, 1e-8)
    assert float(point.primal[1, 2]) == pytest.approx(expected, abs=1e-5)


def test_the_publications_sparsity_for_a_complete_graph_of_maps():
    view = torch.arange(5).repeat_interleave(2)
    identity = torch.arange(2).repeat(5)
    matches = (identity[:, None] == identity).float().fill_diagonal_(0)
    assert map_density(matches, view) == pytest.approx((5 * 4 / 2) ** 0.5 / (2 * 5))
    affinity = mx.Affinity.from_dense(matches, view)
    association = mx.solve(affinity, MatchLift(evidence="match", sparsity=None))
    assert torch.equal(association.labels, identity)


def test_running_out_of_iterations_is_said_and_still_feasible():
    generator = torch.Generator().manual_seed(0)
    scores = torch.rand(20, 20, generator=generator)
    affinity = mx.Affinity.from_dense((scores + scores.T) / 2, torch.arange(20) % 5)
    association = mx.solve(affinity, MatchLift(max_iterations=3))
    assert association.status is mx.Status.ROUNDED
    assert association.stats["iterations"] == 3
    assert association.labels is not None


def partitions(m):
    """All partitions of m things, as labels numbered in the order of first appearance."""
    if m == 0:
        yield ()
        return
    for labels in partitions(m - 1):
        for label in range(max(labels, default=-1) + 2):
            yield (*labels, label)


@pytest.mark.parametrize("seed", range(3))
def test_relaxation_bounds_the_best_clustering(seed):
    # With as many objects allowed as there are observations, no clustering is excluded.
    generator = torch.Generator().manual_seed(seed)
    scores = torch.rand(7, 7, generator=generator, dtype=torch.float64)
    affinity = mx.Affinity.from_dense((scores + scores.T) / 2, torch.arange(7) % 3)
    problem = problem_of(affinity)
    feasible = [torch.tensor(labels) for labels in partitions(7)]
    assert len(feasible) == 877  # Bell's number
    feasible = [labels for labels in feasible if is_distinct(labels, affinity.view)]
    best = min(objective_of(problem, labels) for labels in feasible)
    # cost = 1 − 2 s over unordered pairs; the program has 0.5 − s over ordered ones: the same.
    association = mx.solve(affinity, MatchLift(universe=7, tolerance=1e-6))
    assert association.stats["relaxed_bound"] <= best + 1e-6
    assert association.stats["relaxed_bound"] == pytest.approx(best, rel=0.2)
    assert association.objective >= best - 1e-9
