"""Fusion: the paper's objective worked out with Kronecker products, and likelihood ratios."""

import math

import numpy as np
import pytest
import torch

import mixer_torch as mx

NAMES = ("a", "b")


def test_linear_cost_is_the_frobenius_objective_up_to_a_constant():
    rng = np.random.default_rng(0)
    scores = rng.random((2, 4, 4))
    scores = (scores + scores.transpose(0, 2, 1)) / 2
    affinity = mx.Affinity.from_dense(scores, np.arange(4))
    full = np.zeros((4, 2, 4, 2))
    for k in range(2):
        full[:, k, :, k] = scores[k]
    full = full.reshape(8, 8)

    def objective(labels):
        together = (np.array(labels)[:, None] == labels).astype(float)
        return np.square(np.kron(together, np.eye(2)) - full).sum()

    def cost(labels):
        a, b = affinity.pairs.numpy()
        together = np.array(labels)[a] == np.array(labels)[b]
        return affinity.cost().numpy()[together].sum()

    base = [0, 1, 2, 3]
    for labels in ([0, 0, 0, 0], [0, 0, 1, 1], [0, 1, 0, 2], base):
        change = objective(labels) - objective(base)
        assert change == pytest.approx(2 * cost(labels))  # each pair is in the matrix twice


def test_log_odds_is_the_negative_log_likelihood_ratio_up_to_its_cap():
    scores = torch.tensor([[0.5, 0.8, 0.0, 1.0]])
    cost = mx.LogOddsFusion(cap=3)(scores, ("a",))
    assert cost.tolist() == pytest.approx([0, -math.log(4), 3, -3], abs=1e-6)


def test_with_a_prior_the_cost_is_the_negative_log_posterior_odds():
    scores = torch.tensor([[0.5, 0.8], [0.5, 0.8]])
    cost = mx.LogOddsFusion(prior=0.2)(scores, NAMES)
    # Bayes: 0.2 * 0.8² / (0.2 * 0.8² + 0.8 * 0.2²) = 0.8
    assert cost.tolist() == pytest.approx([math.log(4), -math.log(0.8 / 0.2)], abs=1e-6)
    for prior in (0.0, 1.0, math.nan):
        with pytest.raises(ValueError, match="prior: expected a number between 0 and 1"):
            mx.LogOddsFusion(prior=prior)


@pytest.mark.parametrize("fusion", [mx.LinearFusion, mx.LogOddsFusion])
def test_indifferent_is_free_and_more_alike_is_cheaper(fusion):
    scores = torch.linspace(0.05, 0.95, 19).repeat(2, 1)
    cost = fusion()(scores, NAMES)
    assert cost[9] == pytest.approx(0, abs=1e-5)
    assert bool((cost.diff() < 0).all())
    assert torch.allclose(cost, 2 * fusion()(scores[:1], ("a",)))
    assert torch.allclose(cost, -cost.flip(0), atol=1e-4)


def test_weights_are_by_name_and_checked():
    scores = torch.tensor([[0.9], [0.2]])
    fusion = mx.LinearFusion({"b": 2.0})
    assert fusion(scores, NAMES).item() == pytest.approx(-0.8 + 2 * 0.6)
    assert mx.LinearFusion({"b": 0.0})(scores, NAMES).item() == pytest.approx(-0.8)
    with pytest.raises(KeyError, match="no modality 'c'; modalities: a, b"):
        mx.LinearFusion({"c": 1.0})(scores, NAMES)
    for weight in (-1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match=r"weights\['a'\]: expected a finite number >= 0"):
            mx.LinearFusion({"a": weight})
    with pytest.raises(ValueError, match="cap: expected a finite number > 0, got 0"):
        mx.LogOddsFusion(cap=0)


@pytest.mark.parametrize("fusion", [mx.LinearFusion(), mx.LogOddsFusion()])
def test_gradient(fusion):
    scores = torch.rand(2, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    scores = (0.1 + 0.8 * scores).requires_grad_()
    assert torch.autograd.gradcheck(lambda s: fusion(s, NAMES), scores)
    assert fusion(scores[:, :0], NAMES).shape == (0,)
