"""The derivative of the relaxed clustering against finite differences, and its memory."""

import pytest
import torch

from mixer_torch.solvers.eigen import extreme_eigenvalues
from mixer_torch.train.clustering import Relaxation, association_loss


@pytest.fixture
def problem():
    """Four objects in three views, noisy costs, as a function of the costs of pairs."""
    generator = torch.Generator().manual_seed(0)
    identity, view = torch.arange(12) % 4, torch.arange(12) // 4
    pairs = torch.triu_indices(12, 12, 1)
    pairs = pairs[:, view[pairs[0]] != view[pairs[1]]]
    same = identity[pairs[0]] == identity[pairs[1]]
    noise = torch.randn(len(same), generator=generator, dtype=torch.float64)
    cost = torch.where(same, -1.0, 1.0).double() + 0.9 * noise

    def matrix(cost):
        full = cost.new_zeros(12, 12)
        return full.index_put((pairs[0], pairs[1]), cost).index_put((pairs[1], pairs[0]), cost)

    return cost, matrix, view, pairs, same


def test_gradient_against_finite_differences(problem):
    cost, matrix, view, pairs, same = problem
    scale = -extreme_eigenvalues(matrix(cost)[None])[0][0]
    relaxation = Relaxation(columns=6, settle=2_500, curvature=(-0.8, -0.3), terms=800)

    def loss(cost):
        return association_loss(relaxation(matrix(cost), view, scale), pairs, same)

    leaf = cost.clone().requires_grad_()
    loss(leaf).backward()
    assert float(leaf.grad.abs().max()) > 1e-4
    generator = torch.Generator().manual_seed(1)
    for _ in range(2):
        direction = torch.randn(len(cost), generator=generator, dtype=torch.float64)
        with torch.no_grad():
            ahead, behind = loss(cost + 1e-5 * direction), loss(cost - 1e-5 * direction)
        expected = float(ahead - behind) / 2e-5
        assert float(leaf.grad @ direction) == pytest.approx(expected, rel=0.02, abs=1e-5)


def test_last_step_alone_is_what_autograd_says(problem):
    cost, matrix, view, _, _ = problem
    scale = -extreme_eigenvalues(matrix(cost)[None])[0][0]
    relaxation = Relaxation(columns=6, iterations=20, settle=20, terms=0)
    leaf = cost.clone().requires_grad_()
    result = relaxation(matrix(leaf), view, scale)
    weight = torch.randn(result.shape, generator=torch.Generator().manual_seed(2)).double()
    (result * weight).sum().backward()
    assert float(leaf.grad.abs().sum()) > 0
    assert bool(leaf.grad.isfinite().all())


def test_memory_grows_with_neither_steps_nor_terms(problem):
    cost, matrix, view, pairs, same = problem

    def kept(settle, terms):
        sizes = []

        def pack(tensor):
            sizes.append(tensor.numel())
            return tensor

        with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
            leaf = cost.clone().requires_grad_()
            relaxation = Relaxation(columns=6, settle=settle, terms=terms)
            association_loss(relaxation(matrix(leaf), view), pairs, same).backward()
        return sum(sizes)

    assert kept(10, 5) == kept(200, 100)


def test_rows_are_on_the_simplex_and_loss_is_that_of_f1(problem):
    cost, matrix, view, pairs, same = problem
    with torch.no_grad():
        assignment = Relaxation(columns=6)(matrix(cost), view)
    torch.testing.assert_close(assignment.sum(1), torch.ones(12).double())
    assert bool((assignment >= 0).all())
    truth = torch.nn.functional.one_hot(torch.arange(12) % 4, 6).double()
    assert float(association_loss(truth, pairs, same)) == 0.0
    apart = torch.eye(12).double()
    assert float(association_loss(apart, pairs, same)) == 1.0


def test_descending_the_loss_improves_the_association(problem):
    cost, matrix, view, pairs, same = problem
    relaxation = Relaxation(columns=6)
    leaf = cost.clone().requires_grad_()
    optimiser = torch.optim.Adam([leaf], lr=0.05)
    losses = []
    for _ in range(15):
        optimiser.zero_grad()
        loss = association_loss(relaxation(matrix(leaf), view), pairs, same)
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0] / 2
