"""Every formula of the relaxation against its definition."""

import itertools

import numpy as np
import pytest
import torch
from paper import evaluated, frobenius_objective

from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.gradient.relaxation import (
    distinctness_matrix,
    distinctness_penalty,
    graduated_objective,
    graduated_step,
    is_binary,
    orthogonality_penalty,
    pair_cost,
    project_to_row_sum_at_most_one,
    project_to_simplex,
    row_sum_penalty,
)
from mixer_torch.solvers.problem import objective_of, problem_of

PROJECTIONS = [project_to_simplex, project_to_row_sum_at_most_one]


def random_problem(seed, batch=(), m=7, k=5):
    """U, Ā and the views of small problems, in float64; Ā is 0 within views."""
    generator = torch.Generator().manual_seed(seed)
    assignment = torch.rand(*batch, m, k, generator=generator, dtype=torch.float64)
    view = torch.randint(0, 4, (*batch, m), generator=generator)
    cost = torch.randn(*batch, m, m, generator=generator, dtype=torch.float64)
    cost = (cost + cost.mT) * (view[..., :, None] != view[..., None, :])
    return assignment, cost, view


def feasible_labels(view, generator):
    """Random labels, no two of one view alike."""
    labels = torch.empty_like(view)
    for value in view.unique():
        rows = (view == value).nonzero()[:, 0]
        labels[rows] = torch.randperm(len(view), generator=generator)[: len(rows)]
    return labels


def one_hot(labels, columns, dtype=torch.float64):
    return torch.nn.functional.one_hot(labels, columns).to(dtype)


def test_penalties_are_the_matrix_products_of_the_paper():
    U, A, view = random_problem(0)
    m, k = U.shape
    P_o = torch.ones(k, k, dtype=U.dtype) - torch.eye(k, dtype=U.dtype)
    P_d = distinctness_matrix(view, U.dtype)
    for a in range(m):
        for b in range(m):
            assert P_d[a, b] == float(a != b and view[a] == view[b])
    assert orthogonality_penalty(U) == pytest.approx(float(((U.T @ U) * P_o).sum()))
    assert distinctness_penalty(U, P_d @ U) == pytest.approx(float(((U @ U.T) * P_d).sum()))
    assert pair_cost(U, A @ U) == pytest.approx(float(((U @ U.T) * A).sum()))
    # The paper writes <UᵀU − Uᵀ − U, 1> for square U: the sum of all entries.
    expected = (U.T @ U).sum() - 2 * U.sum()
    assert row_sum_penalty(U) == pytest.approx(float(expected))


@pytest.mark.parametrize("seed", range(3))
def test_gradient_against_autograd_and_finite_differences(seed):
    U, A, view = random_problem(seed, batch=(2,))
    P_d = distinctness_matrix(view, U.dtype)
    d = torch.tensor([0.3, 7.0], dtype=U.dtype)
    U.requires_grad_()
    evaluated(U, A, P_d).objective(d).sum().backward()
    gradient = evaluated(U.detach(), A, P_d).gradient(d)
    torch.testing.assert_close(gradient, U.grad)
    step = 1e-6
    direction = torch.randn_like(U)
    with torch.no_grad():
        plus, minus = (evaluated(U + s * direction, A, P_d).objective(d) for s in (step, -step))
    numeric = (plus - minus) / (2 * step)
    torch.testing.assert_close(numeric, (gradient * direction).sum((1, 2)), rtol=1e-6, atol=1e-6)


def test_a_batch_is_its_problems_one_by_one():
    U, A, view = random_problem(5, batch=(2, 3))
    P_d = distinctness_matrix(view, U.dtype)
    d = torch.full((2, 3), 0.7, dtype=U.dtype)
    together = evaluated(U, A, P_d)
    assert together.objective(d).shape == (2, 3)
    for i in range(2):
        for j in range(3):
            alone = evaluated(U[i, j], A[i, j], P_d[i, j])
            torch.testing.assert_close(together.objective(d)[i, j], alone.objective(d[i, j]))
            torch.testing.assert_close(together.gradient(d)[i, j], alone.gradient(d[i, j]))


@pytest.mark.parametrize("seed", range(5))
def test_frobenius_objective_is_a_constant_plus_the_pair_cost(seed):
    """‖U Uᵀ ⊗ I_l − A‖²_F with the explicit Kronecker matrix, against const + <U Uᵀ, Ā>."""
    affinity, _ = synthetic(
        objects=3, views=3, modalities=3, inconclusive=0.3, seed=seed, dtype=torch.float64
    )
    m, l = len(affinity), 3
    scores = affinity.dense()
    A = torch.zeros(m, l, m, l, dtype=torch.float64)
    for k in range(l):
        A[:, k, :, k] = scores[k]
    A = A.reshape(m * l, m * l)
    problem = problem_of(affinity)
    cost = problem.dense_cost()
    generator = torch.Generator().manual_seed(seed)
    constant = None
    for _ in range(4):
        labels = feasible_labels(affinity.view, generator)
        U = one_hot(labels, m)
        together = torch.kron(U @ U.T, torch.eye(l, dtype=torch.float64))
        explicit = (together - A).square().sum()
        torch.testing.assert_close(frobenius_objective(U, scores), explicit)
        pairs = pair_cost(U, cost @ U)
        assert float(pairs) == pytest.approx(2 * objective_of(problem, labels))
        constant = explicit - pairs if constant is None else constant
        torch.testing.assert_close(explicit - pairs, constant)


def test_penalties_vanish_exactly_where_binary_assignments_are_feasible():
    generator = torch.Generator().manual_seed(0)
    feasible = 0
    for _ in range(200):
        view = torch.randint(0, 4, (6,), generator=generator)
        labels = torch.randint(0, 6, (6,), generator=generator)
        U, P_d = one_hot(labels, 6), distinctness_matrix(view, torch.float64)
        same = (labels[:, None] == labels) & (view[:, None] == view)
        ok = int(same.sum()) == 6
        feasible += ok
        assert orthogonality_penalty(U) == 0
        assert row_sum_penalty(U) == -6
        assert (float(distinctness_penalty(U, P_d @ U)) == 0) == ok
    assert 0 < feasible < 200
    twice = U.clone()
    twice[0] = 0.5
    assert orthogonality_penalty(twice) > 0
    assert row_sum_penalty(0.9 * U) > -6


def total_is_right(project, rows):
    total = rows.sum(-1)
    if project is project_to_simplex:
        return bool(((total - 1).abs() < 1e-12).all())
    return bool((total <= 1 + 1e-12).all())


@pytest.mark.parametrize("project", PROJECTIONS)
@pytest.mark.parametrize("scale", [0.1, 1.0, 1e6])
def test_projection_is_feasible_idempotent_and_nearest(project, scale):
    generator = torch.Generator().manual_seed(1)
    rows = scale * torch.randn(50, 6, generator=generator, dtype=torch.float64)
    projected = project(rows)
    assert bool((projected >= 0).all())
    assert total_is_right(project, projected)
    torch.testing.assert_close(project(projected), projected, rtol=0, atol=1e-12)
    # The projection onto a convex set: <v − u, w − u> <= 0 for every feasible w.
    others = project(torch.randn(1000, 6, generator=generator, dtype=torch.float64))
    others = torch.cat([others, torch.eye(6, dtype=torch.float64)])
    inner = ((rows - projected)[:, None] * (others - projected[:, None])).sum(-1)
    assert float(inner.max()) <= 1e-9 * scale


@pytest.mark.parametrize("project", PROJECTIONS)
def test_projection_against_all_supports(project):
    """The nearest of all stationary points: one for each support, with the sum binding or not."""
    generator = np.random.default_rng(2)
    supports = [np.array(s, bool) for s in itertools.product([0, 1], repeat=5)]
    for _ in range(30):
        row = generator.normal(size=5) * generator.choice([0.3, 2.0])
        points = [np.where(s, row - (row[s].sum() - 1) / s.sum(), 0) for s in supports if s.any()]
        if project is project_to_row_sum_at_most_one:
            points += [np.where(s, row, 0) for s in supports]
        points = [u for u in points if u.min() >= 0 and u.sum() <= 1 + 1e-12]
        nearest = min(points, key=lambda u, row=row: ((u - row) ** 2).sum())
        np.testing.assert_allclose(project(torch.from_numpy(row)), nearest, atol=1e-12)


@pytest.mark.parametrize("project", PROJECTIONS)
def test_jacobian_of_the_projection(project):
    """diag(s) − s sᵀ / |s| on the support s where the sum binds, diag(s) where it does not."""
    generator = torch.Generator().manual_seed(3)
    for _ in range(20):
        row = 0.4 * torch.randn(6, generator=generator, dtype=torch.float64)
        jacobian = torch.autograd.functional.jacobian(project, row)
        support = (project(row) > 0).double()
        expected = torch.diag(support)
        if float(project(row).sum()) > 1 - 1e-12:
            expected -= torch.outer(support, support) / support.sum()
        torch.testing.assert_close(jacobian, expected, atol=1e-9, rtol=0)


def test_projections_worked_by_hand():
    row = torch.tensor([[0.5, 0.2, -1.0], [2.0, 1.5, 0.0]])
    # 0.5 and 0.2 lack 0.3, which they share; 2 and 1.5 exceed by 2.5, and so do both in the second.
    torch.testing.assert_close(
        project_to_simplex(row), torch.tensor([[0.65, 0.35, 0.0], [0.75, 0.25, 0.0]])
    )
    torch.testing.assert_close(
        project_to_row_sum_at_most_one(row), torch.tensor([[0.5, 0.2, 0.0], [0.75, 0.25, 0.0]])
    )


def test_binary():
    U = torch.tensor([[[1.0, 0.0], [0.0, 0.999]], [[1.0, 1.0], [0.0, 1.0]], [[0.5, 0.5], [0, 1]]])
    assert is_binary(U).tolist() == [True, False, False]


def test_objective_at_a_feasible_point_is_the_cost_less_the_constant():
    affinity, truth = synthetic(objects=4, views=4, seed=0, dtype=torch.float64)
    problem = problem_of(affinity)
    U = one_hot(truth, len(truth))
    P_d = distinctness_matrix(problem.view, torch.float64)
    value = evaluated(U, problem.dense_cost(), P_d).objective(torch.tensor(3.0))
    assert float(value) == pytest.approx(2 * objective_of(problem, truth) - 3 * len(truth))


def test_the_graduated_objective_and_its_step_are_those_of_the_paper_on_the_simplex():
    """Row sums of 1 and d = c: F_d with its own weight w of distinctness, but for a constant."""
    U, A, view = random_problem(7)
    U = project_to_simplex(U)
    P_d = distinctness_matrix(view, U.dtype)
    c, step = (torch.tensor([[x]], dtype=U.dtype) for x in (0.8, 0.01))
    w, m = 1.7, torch.tensor([len(U)])
    quadratic = A + w * P_d
    U.requires_grad_()
    form, square = (U * (quadratic @ U)).sum().view(1, 1), U.square().sum().view(1, 1)
    value = graduated_objective(form, square, m, c)
    expected = evaluated(U, quadratic, 0 * P_d).objective(c[0, 0]) + c * len(U)
    torch.testing.assert_close(value, expected)
    value.backward()
    hold, back = graduated_step(step, c)
    torch.testing.assert_close(hold * U + back * (quadratic @ U), U.detach() - step / 2 * U.grad)
