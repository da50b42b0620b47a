"""Calibrators that are fitted to labelled pairs, from one parameter to a monotone spline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import softplus

from mixer_torch.scorers.likelihood_ratio import LikelihoodRatio

PROBABILITY_EPS = 1e-6


class Platt(LikelihoodRatio):
    """h(x) = a z + b with z the standardised evidence: logistic regression (Platt 1999).

    Args:
        covariates: Names of covariates, see :class:`~mixer_torch.scorers.likelihood_ratio.LikelihoodRatio`.
        regularisation: Weight of a² and of the covariates' squares in the loss.
        counted: Whether covariates are evidence themselves.
    """

    centre: Tensor
    spread: Tensor

    def __init__(
        self, covariates: Sequence[str] = (), regularisation: float = 1e-4, counted: bool = False
    ) -> None:
        super().__init__(covariates, regularisation, counted)
        self.slope = nn.Parameter(torch.zeros((), dtype=torch.float64))
        self.intercept = nn.Parameter(torch.zeros((), dtype=torch.float64))
        self.register_buffer("centre", torch.zeros((), dtype=torch.float64))
        self.register_buffer("spread", torch.ones((), dtype=torch.float64))

    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        self.centre.copy_(x.mean())
        self.spread.copy_(x.std(correction=0).clamp(min=1e-9))

    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return self.slope * (x - self.centre) / self.spread + self.intercept

    def penalty(self) -> Tensor:
        return super().penalty() + self.slope.square()


class Temperature(LikelihoodRatio):
    """h(x) = logit(x) / T of evidence that is a score already: temperature scaling (Guo et al.
    2017). What was 0.5 stays 0.5.

    Args:
        covariates: Names of covariates, see :class:`~mixer_torch.scorers.likelihood_ratio.LikelihoodRatio`.
        regularisation: Weight of 1 / T² and of the covariates' squares in the loss.
        counted: Whether covariates are evidence themselves.
    """

    def __init__(
        self, covariates: Sequence[str] = (), regularisation: float = 1e-4, counted: bool = False
    ) -> None:
        super().__init__(covariates, regularisation, counted)
        self.inverse = nn.Parameter(torch.full((), 0.5413, dtype=torch.float64))

    @property
    def temperature(self) -> Tensor:
        """T > 0."""
        return 1 / softplus(self.inverse)

    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        _check_probabilities(type(self).__name__, x)

    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return torch.logit(x, eps=PROBABILITY_EPS) * softplus(self.inverse)

    def penalty(self) -> Tensor:
        return super().penalty() + softplus(self.inverse).square()


class Beta(LikelihoodRatio):
    """h(x) = a log x - b log(1 - x) + c with a, b >= 0, of evidence in [0, 1]: beta calibration
    (Kull et al. 2017), exact where both kinds of pairs have beta distributions.

    Args:
        covariates: Names of covariates, see :class:`~mixer_torch.scorers.likelihood_ratio.LikelihoodRatio`.
        regularisation: Weight of a² + b² and of the covariates' squares in the loss.
        counted: Whether covariates are evidence themselves.
    """

    def __init__(
        self, covariates: Sequence[str] = (), regularisation: float = 1e-4, counted: bool = False
    ) -> None:
        super().__init__(covariates, regularisation, counted)
        self.exponents = nn.Parameter(torch.zeros(2, dtype=torch.float64))
        self.intercept = nn.Parameter(torch.zeros((), dtype=torch.float64))

    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        _check_probabilities(type(self).__name__, x)

    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        a, b = softplus(self.exponents)
        x = x.clamp(PROBABILITY_EPS, 1 - PROBABILITY_EPS)
        return a * x.log() - b * torch.log1p(-x) + self.intercept

    def penalty(self) -> Tensor:
        return super().penalty() + softplus(self.exponents).square().sum()


class Histogram(LikelihoodRatio):
    """h(x) = log of the ratio of the two kinds' shares in the bin of x, with a prior count.

    A bin holds n_s of N_s same and n_d of N_d different pairs; with the odds o = N_s / N_d,

        h = log (n_s + 1) / (n_d + 1 / o) - log o,

    which is 0 in an empty bin. The bins hold equal shares of the two kinds together, each kind
    counted as one half. It need not be monotone.

    Args:
        bins: Number of bins at most; equal evidence is never parted.
        covariates: Names of covariates, see :class:`~mixer_torch.scorers.likelihood_ratio.LikelihoodRatio`.
        regularisation: Weight of the covariates' squares in the loss.
        counted: Whether covariates are evidence themselves.

    Raises:
        ValueError: bins < 1.
    """

    edges: Tensor
    values: Tensor

    def __init__(
        self,
        bins: int = 15,
        covariates: Sequence[str] = (),
        regularisation: float = 1e-4,
        counted: bool = False,
    ) -> None:
        super().__init__(covariates, regularisation, counted)
        if bins < 1:
            raise ValueError(f"bins: expected an integer >= 1, got {bins}")
        self.bins = bins
        self.register_buffer("edges", torch.zeros(0, dtype=torch.float64))
        self.register_buffer("values", torch.zeros(1, dtype=torch.float64))

    @property
    def settings(self) -> dict[str, Any]:
        return {"bins": self.bins, **super().settings}

    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        knots = balanced_quantiles(x, same, self.bins + 1)
        self.edges = ((knots[1:] + knots[:-1]) / 2) if len(knots) <= 2 else knots[1:-1]
        place = torch.searchsorted(self.edges, x, right=True)
        of_same = torch.bincount(place[same], minlength=len(self.edges) + 1).double()
        of_different = torch.bincount(place[~same], minlength=len(self.edges) + 1).double()
        self.values = smoothed_log_ratio(of_same, of_different, self.counts[0] / self.counts[1])

    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return self.values[torch.searchsorted(self.edges, x.detach(), right=True)] + 0 * x


class Isotonic(LikelihoodRatio):
    """h(x), the monotone function of the greatest likelihood (Zadrozny and Elkan 2002).

    Adjacent violators are pooled; the log likelihood ratio of a pool has a prior count as in
    :class:`Histogram`, so that a pure pool is not infinitely sure. Straight lines between pools.

    Args:
        direction: ``increasing`` where more evidence means more alike, ``decreasing`` for
            distances, ``either`` for what the pairs of training say.
        covariates: Names of covariates, see :class:`~mixer_torch.scorers.likelihood_ratio.LikelihoodRatio`.
        regularisation: Weight of the covariates' squares in the loss.
        counted: Whether covariates are evidence themselves.

    Raises:
        ValueError: direction is another.
    """

    knots: Tensor
    values: Tensor

    def __init__(
        self,
        direction: Literal["increasing", "decreasing", "either"] = "either",
        covariates: Sequence[str] = (),
        regularisation: float = 1e-4,
        counted: bool = False,
    ) -> None:
        super().__init__(covariates, regularisation, counted)
        self.direction = _checked(direction)
        self.register_buffer("knots", torch.zeros(1, dtype=torch.float64))
        self.register_buffer("values", torch.zeros(1, dtype=torch.float64))

    @property
    def settings(self) -> dict[str, Any]:
        return {"direction": self.direction, **super().settings}

    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        from scipy.optimize import isotonic_regression

        sign = _sign(self.direction, x, same)
        value, place = torch.unique(sign * x, return_inverse=True)
        total = torch.bincount(place, minlength=len(value)).double()
        hits = torch.bincount(place[same], minlength=len(value)).double()
        mean = isotonic_regression((hits / total).cpu().numpy(), weights=total.cpu().numpy()).x
        pool = torch.unique_consecutive(torch.from_numpy(mean).to(x), return_inverse=True)[1]
        of_same = torch.zeros(int(pool.max()) + 1).to(x).index_add_(0, pool, hits)
        of_all = torch.zeros_like(of_same).index_add_(0, pool, total)
        odds = self.counts[0] / self.counts[1]
        ratio = smoothed_log_ratio(of_same, of_all - of_same, odds)
        # The prior count weighs more on small pools, which may part their order again.
        smooth = isotonic_regression(ratio.cpu().numpy(), weights=of_all.cpu().numpy()).x
        ends = torch.ones_like(pool, dtype=torch.bool)
        ends[1:-1] = (pool[1:-1] != pool[:-2]) | (pool[1:-1] != pool[2:])
        knots, values = value[ends], torch.from_numpy(smooth.copy()).to(x)[pool[ends]]
        flip = [0] if sign < 0 else []
        self.knots, self.values = (sign * knots).flip(flip), values.flip(flip)

    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        if len(self.knots) == 1:
            return self.values.expand_as(x) + 0 * x
        right = torch.searchsorted(self.knots, x.detach()).clamp(1, len(self.knots) - 1)
        left = right - 1
        share = (x - self.knots[left]) / (self.knots[right] - self.knots[left])
        return torch.lerp(self.values[left], self.values[right], share.clamp(0, 1))


class MonotoneSpline(LikelihoodRatio):
    """h(x), a monotone quadratic spline: its derivative is piecewise linear and never negative.

        h(x) = b + sign * Σ_j softplus(w_j) B_j(x),   B_j(x) = ∫ hat function of knot j

    (I-splines, Ramsay 1988). The knots are quantiles at which both kinds of pairs count alike; the
    B_j are scaled to rise from 0 to 1. Beyond the outermost knots h is constant.

    Args:
        knots: Number of knots at most.
        direction: ``increasing`` where more evidence means more alike, ``decreasing`` for
            distances, ``either`` for what the pairs of training say.
        covariates: Names of covariates, see :class:`~mixer_torch.scorers.likelihood_ratio.LikelihoodRatio`.
        regularisation: Weight of the squared rises and of the covariates' squares in the loss.
        counted: Whether covariates are evidence themselves.

    Raises:
        ValueError: knots < 2, or direction is another.
    """

    places: Tensor
    sign: Tensor

    def __init__(
        self,
        knots: int = 10,
        direction: Literal["increasing", "decreasing", "either"] = "either",
        covariates: Sequence[str] = (),
        regularisation: float = 1e-4,
        counted: bool = False,
    ) -> None:
        super().__init__(covariates, regularisation, counted)
        if knots < 2:
            raise ValueError(f"knots: expected an integer >= 2, got {knots}")
        self.knots = knots
        self.direction = _checked(direction)
        self.rises = nn.Parameter(torch.full((2,), -4.0, dtype=torch.float64))
        self.intercept = nn.Parameter(torch.zeros((), dtype=torch.float64))
        self.register_buffer("places", torch.tensor([0.0, 1.0], dtype=torch.float64))
        self.register_buffer("sign", torch.ones((), dtype=torch.float64))

    @property
    def settings(self) -> dict[str, Any]:
        return {"knots": self.knots, "direction": self.direction, **super().settings}

    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        self.sign.fill_(_sign(self.direction, x, same))
        places = balanced_quantiles(x, same, self.knots)
        self.places = places if len(places) > 1 else torch.stack([places[0], places[0] + 1])
        self.rises.data = self.rises.new_full((len(self.places),), -2.0)
        self.intercept.data.zero_()

    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return self.intercept + self.sign * (self.basis(x) @ softplus(self.rises))

    def basis(self, x: Float[Tensor, " P"]) -> Float[Tensor, "P k"]:
        """B_j(x), rising from 0 to 1 between the neighbours of knot j."""
        x = x[:, None].clamp(self.places[0], self.places[-1])
        width = self.places.diff()
        share = ((x - self.places[:-1]) / width).clamp(0, 1)
        up, down = share.square() / 2, share - share.square() / 2
        nothing = torch.zeros_like(x)
        area = torch.cat([nothing, up * width], 1) + torch.cat([down * width, nothing], 1)
        none = width.new_zeros(1)
        return area / (torch.cat([none, width]) / 2 + torch.cat([width, none]) / 2)

    def penalty(self) -> Tensor:
        return super().penalty() + softplus(self.rises).square().sum()


def balanced_quantiles(
    x: Float[Tensor, " P"], same: Bool[Tensor, " P"], count: int
) -> Float[Tensor, " k"]:
    """Extremes and quantiles between them, up to ``count`` values, each kind counted as a half."""
    order = torch.argsort(x)
    weight = torch.where(same, 0.5 / same.sum(), 0.5 / (~same).sum())[order]
    wanted = torch.linspace(0, 1, count, dtype=x.dtype, device=x.device)
    place = torch.searchsorted(weight.cumsum(0), wanted).clamp(max=len(x) - 1)
    place[0], place[-1] = 0, len(x) - 1
    return torch.unique(x[order[place]])


def smoothed_log_ratio(same: Tensor, different: Tensor, odds: Tensor) -> Tensor:
    """The value of log (n_s + 1) / (n_d + 1 / o) - log o: 0 where there is nothing."""
    return ((same + 1) / (different + 1 / odds)).log() - odds.log()


def _sign(direction: str, x: Tensor, same: Tensor) -> float:
    if direction == "either":
        rank = torch.empty_like(x)
        rank[torch.argsort(x, stable=True)] = torch.arange(len(x), dtype=x.dtype, device=x.device)
        return 1.0 if rank[same].mean() >= rank[~same].mean() else -1.0
    return 1.0 if direction == "increasing" else -1.0


def _checked(direction: str) -> str:
    if direction not in ("increasing", "decreasing", "either"):
        raise ValueError(
            f"direction: expected 'increasing', 'decreasing' or 'either', got {direction!r}"
        )
    return direction


def _check_probabilities(name: str, x: Tensor) -> None:
    if not bool(((x >= 0) & (x <= 1)).all()):
        wrong = x[~((x >= 0) & (x <= 1))][0].item()
        raise ValueError(f"evidence: {name} takes values in [0, 1], got {wrong}")
