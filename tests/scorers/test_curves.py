"""Calibrators: values worked by hand, and the fit against an independent library."""

import math

import numpy as np
import pytest
import torch
from sklearn.linear_model import LogisticRegression

from mixer_torch.scorers.curves import Logistic, PiecewiseLinear


def test_logistic_by_hand():
    score = Logistic(2.0, 1.0)(torch.tensor([1.0, 1.0 + math.log(3) / 2, -50.0, 50.0]))
    torch.testing.assert_close(score, torch.tensor([0.5, 0.75, 0.0, 1.0]), rtol=0, atol=1e-6)


def test_logistic_keeps_its_limits():
    score = Logistic(-3.0, 0.0, floor=0.1, ceiling=0.9)(torch.tensor([-100.0, 0.0, 100.0]))
    torch.testing.assert_close(score, torch.tensor([0.9, 0.5, 0.1]))


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((float("nan"), 0.0), "slope"),
        ((1.0, float("inf")), "midpoint"),
        ((1.0, 0.0, 0.6, 0.4), "floor"),
        ((1.0, 0.0, 0.0, 1.5), "ceiling"),
    ],
)
def test_logistic_refuses(arguments, name):
    with pytest.raises(ValueError, match=name):
        Logistic(*arguments)


def gaussians(same, different, seed=0):
    """Evidence of variance 1 with means 1 and -1, whose log likelihood ratio is exactly 2 x."""
    generator = torch.Generator().manual_seed(seed)
    evidence = torch.randn(same + different, generator=generator, dtype=torch.float64)
    label = torch.arange(same + different) < same
    return evidence + torch.where(label, 1.0, -1.0), label


@pytest.mark.parametrize("share", [0.5, 0.02])
def test_fit_finds_the_likelihood_ratio_whatever_the_prior(share):
    same = int(200_000 * share)
    fitted = Logistic.fit(*gaussians(same, 200_000 - same), regularisation=0.0)
    assert fitted.slope == pytest.approx(2.0, abs=0.06)
    assert fitted.midpoint == pytest.approx(0.0, abs=0.03)


def test_fit_is_that_of_scikit_learn():
    evidence, same = gaussians(60, 500)
    model = LogisticRegression(C=np.inf, tol=1e-10, max_iter=1000)
    model.fit(evidence[:, None].numpy(), same.numpy())
    slope, offset = float(model.coef_[0, 0]), float(model.intercept_[0])
    fitted = Logistic.fit(evidence, same, regularisation=0.0)
    assert fitted.slope == pytest.approx(slope, rel=1e-4)
    assert fitted.midpoint == pytest.approx(-(offset - math.log(60 / 500)) / slope, abs=1e-4)


def test_fit_of_evidence_that_separates_is_finite():
    fitted = Logistic.fit(torch.tensor([0.0, 1.0, 2.0, 3.0]), torch.tensor([0, 0, 1, 1]))
    assert 0 < fitted.slope < math.inf
    assert fitted.midpoint == pytest.approx(1.5, abs=1e-3)


def test_fit_of_constant_evidence_says_nothing():
    fitted = Logistic.fit(torch.ones(6), torch.tensor([1, 0, 0, 0, 0, 0]))
    assert fitted(torch.tensor([1.0])).item() == pytest.approx(0.5, abs=1e-3)


def test_fit_leaves_out_what_says_nothing():
    evidence, same = gaussians(30, 90)
    holes = torch.cat([evidence, torch.full((40,), torch.nan, dtype=torch.float64)])
    labels = torch.cat([same, torch.ones(40, dtype=torch.bool)])
    assert Logistic.fit(holes, labels).slope == Logistic.fit(evidence, same).slope


@pytest.mark.parametrize(
    ("evidence", "same"), [([1.0, 2.0], [True]), ([1.0, 2.0], [True, True]), ([], [])]
)
def test_fit_refuses(evidence, same):
    with pytest.raises(ValueError, match="same"):
        Logistic.fit(torch.tensor(evidence), torch.tensor(same, dtype=torch.bool))


def test_piecewise_linear_is_that_of_numpy():
    knots, scores = [-1.0, 0.0, 0.5, 4.0], [0.1, 0.5, 0.45, 0.9]
    evidence = torch.linspace(-3, 6, 200, dtype=torch.float64)
    expected = np.interp(evidence.numpy(), knots, scores)
    np.testing.assert_allclose(PiecewiseLinear(knots, scores)(evidence).numpy(), expected)


def test_piecewise_linear_of_one_point_is_constant():
    score = PiecewiseLinear([3.0], [0.7])(torch.tensor([-1.0, 3.0, 9.0]))
    torch.testing.assert_close(score, torch.full((3,), 0.7))


def test_piecewise_linear_has_the_slope_of_its_segment():
    evidence = torch.tensor([0.5, 2.0, 9.0], requires_grad=True)
    PiecewiseLinear([0.0, 1.0, 3.0], [0.0, 0.5, 0.9])(evidence).sum().backward()
    torch.testing.assert_close(evidence.grad, torch.tensor([0.5, 0.2, 0.0]))


@pytest.mark.parametrize(
    ("knots", "scores", "name"),
    [
        ([0.0, 1.0], [0.5], "evidence, scores"),
        ([], [], "evidence, scores"),
        ([1.0, 1.0], [0.2, 0.5], "evidence"),
        ([0.0, 1.0], [0.2, 1.5], "scores"),
    ],
)
def test_piecewise_linear_refuses(knots, scores, name):
    with pytest.raises(ValueError, match=name):
        PiecewiseLinear(knots, scores)
