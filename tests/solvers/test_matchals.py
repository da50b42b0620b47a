"""MatchALS against its convex equivalent, and its least squares against the normal equations."""

import pytest
import torch

import mixer_torch as mx
from mixer_torch.solvers.matchals import MatchALS, least_squares, low_rank_matches
from mixer_torch.solvers.matchlift import Program, solve_program


@pytest.mark.parametrize("seed", range(3))
def test_objective_of_the_semidefinite_program(seed):
    """With a heavy nuclear norm X is positive semidefinite, and the program is a semidefinite one.

    ‖X‖_* ≥ trace X = m, with equality just for X ⪰ 0, so that what is left to minimise is
    <β − W, X> over X ⪰ 0 in the same bounds.
    """
    generator = torch.Generator().manual_seed(seed)
    view = torch.arange(16) % 4
    apart = view[:, None] == view
    weight = torch.rand(16, 16, generator=generator, dtype=torch.float64)
    weight = ((weight + weight.T) / 2).masked_fill(apart, 0)
    start = torch.rand(16, 16, generator=generator, dtype=torch.float64)
    matrix, iterations = low_rank_matches(weight, view, start, 50.0, 0.6, 20000, 1e-6)
    assert iterations < 20000
    cost = (0.6 - weight).masked_fill(apart, 0)
    program = Program(cost, apart, torch.eye(16, dtype=torch.float64))
    best = float((cost * solve_program(program, 5000, 1e-7).primal).sum())
    assert float((cost * matrix).sum()) == pytest.approx(best, abs=2e-3 * abs(best))
    assert float(matrix[~apart].min()) > -1e-3
    assert float(matrix.max()) < 1 + 1e-3
    assert float(torch.linalg.eigvalsh(matrix)[0]) > -1e-3


def test_least_squares_by_its_gradient():
    generator = torch.Generator().manual_seed(0)
    factor = torch.rand(7, 3, generator=generator, dtype=torch.float64)
    target = torch.rand(7, 7, generator=generator, dtype=torch.float64)
    other = least_squares(factor, target.T, ridge=0.3).requires_grad_()
    loss = (factor @ other.T - target).square().sum() + 0.3 * other.square().sum()
    (gradient,) = torch.autograd.grad(loss, other)
    torch.testing.assert_close(gradient, torch.zeros_like(gradient), atol=1e-12, rtol=0)


def test_seed_and_rank_are_kept():
    identity = torch.arange(4).repeat(5)
    view = torch.arange(5).repeat_interleave(4)
    affinity = mx.Affinity.from_dense((identity[:, None] == identity).float(), view)
    for seed in range(3):
        association = mx.solve(affinity, MatchALS(seed=seed))
        assert torch.equal(association.labels, identity)
        assert association.stats["rank"] == 8
    assert mx.solve(affinity, MatchALS(rank=6)).stats["rank"] == 6
