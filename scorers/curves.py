"""Calibrators that are fixed curves: a logistic function, or straight lines between points."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from mixer_torch.scoring import Calibrator


class Logistic(Calibrator):
    """score = floor + (ceiling - floor) * sigmoid(slope * (evidence - midpoint)).

    With the default limits, slope * (evidence - midpoint) is the log likelihood ratio of the
    evidence, so that ``midpoint`` is where it speaks neither for nor against.

    Args:
        slope: Log likelihood ratio gained by a unit of evidence, nats; negative for distances.
        midpoint: Evidence halfway between the limits.
        floor: Least score, so that no evidence is infinitely sure that two are different.
        ceiling: Greatest score.

    Raises:
        ValueError: An argument is not finite, or not 0 <= floor <= ceiling <= 1.
    """

    def __init__(
        self, slope: float, midpoint: float, floor: float = 0.0, ceiling: float = 1.0
    ) -> None:
        super().__init__()
        for name, value in (("slope", slope), ("midpoint", midpoint)):
            if not abs(value) < float("inf"):
                raise ValueError(f"{name}: expected a finite number, got {value}")
        if not 0 <= floor <= ceiling <= 1:
            raise ValueError(
                f"floor, ceiling: expected 0 <= floor <= ceiling <= 1, got {floor}, {ceiling}"
            )
        self.slope = slope
        self.midpoint = midpoint
        self.floor = floor
        self.ceiling = ceiling

    def forward(self, evidence: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        score = torch.sigmoid(self.slope * (evidence - self.midpoint))
        return self.floor + (self.ceiling - self.floor) * score

    @classmethod
    def fit(
        cls,
        evidence: Any,
        same: Any,
        floor: float = 0.0,
        ceiling: float = 1.0,
        regularisation: float = 1e-3,
    ) -> Logistic:
        """Logistic regression of ``same`` on evidence, moved from the sample's prior to 0.5.

        The offset of the regression holds the log prior odds log(n_same / n_different) of the
        sample. They are subtracted: what is left is the log likelihood ratio, whose sigmoid is
        the score. :class:`~mixer_torch.scorers.calibrators.Platt` is the same with safeguards.

        Args:
            evidence: (P,) raw evidence; NaN is left out.
            same: (P,) bool, whether the pair shows one object.
            floor: Least score of the calibrator.
            ceiling: Greatest score of the calibrator.
            regularisation: Of the slope of standardised evidence, see
                :func:`logistic_regression`; it keeps the slope finite where the two kinds of
                pairs do not overlap.

        Raises:
            ValueError: The lengths differ, or one of the two kinds is missing.
        """
        x, y, _ = labelled_pairs(evidence, same)
        mean, std = x.mean(), x.std().clamp(min=1e-12)
        columns = torch.stack([(x - mean) / std, torch.ones_like(x)], 1)
        slope, offset = logistic_regression(columns, y.double(), regularisation)
        offset = offset - torch.logit(y.double().mean())
        # A slope of exactly 0 has its midpoint nowhere; a tiny one has it far away.
        slope = torch.where(slope == 0, torch.full_like(slope, 1e-12), slope)
        midpoint = mean - offset / slope * std
        return cls(float(slope / std), float(midpoint), floor, ceiling)

    def extra_repr(self) -> str:
        return f"slope={self.slope:g}, midpoint={self.midpoint:g}"


class PiecewiseLinear(Calibrator):
    """Straight lines between given points, constant outside of them.

    Args:
        evidence: Increasing values of the evidence, at least one.
        scores: The score at each of them, in [0, 1].

    Raises:
        ValueError: The lists differ in length, evidence does not increase, or a score is not in
            [0, 1].
    """

    knots: Tensor
    scores: Tensor

    def __init__(self, evidence: Sequence[float], scores: Sequence[float]) -> None:
        super().__init__()
        if len(evidence) != len(scores) or not len(evidence):
            raise ValueError(
                "evidence, scores: expected two lists of one length, at least 1, "
                f"got {len(evidence)} and {len(scores)}"
            )
        if not all(a < b for a, b in pairwise(evidence)):
            raise ValueError(f"evidence: expected increasing values, got {list(evidence)}")
        if not all(0 <= value <= 1 for value in scores):
            raise ValueError(f"scores: expected values in [0, 1], got {list(scores)}")
        self.register_buffer("knots", torch.tensor(list(evidence), dtype=torch.float64))
        self.register_buffer("scores", torch.tensor(list(scores), dtype=torch.float64))

    def forward(self, evidence: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return interpolate(evidence, self.knots.to(evidence), self.scores.to(evidence))


def interpolate(
    x: Float[Tensor, " P"], knots: Float[Tensor, " k"], values: Float[Tensor, " k"]
) -> Float[Tensor, " P"]:
    """Linear interpolation of (knots, values) at x, constant outside; differentiable in x."""
    if len(knots) == 1:
        return values.expand_as(x) + 0 * x
    right = torch.searchsorted(knots, x.detach()).clamp(1, len(knots) - 1)
    left = right - 1
    share = (x - knots[left]) / (knots[right] - knots[left])
    return torch.lerp(values[left], values[right], share.clamp(0, 1))


def labelled_pairs(
    evidence: Any, same: Any
) -> tuple[Float[Tensor, " k"], Bool[Tensor, " k"], Bool[Tensor, " P"]]:
    """Evidence and truth of the pairs with finite evidence, and which those are.

    Raises:
        ValueError: The lengths differ, or pairs of one of the two kinds are missing.
    """
    x = torch.as_tensor(evidence).detach().double().flatten()
    y = torch.as_tensor(same).to(x.device, torch.bool).flatten()
    if x.shape != y.shape:
        raise ValueError(
            f"same: expected one for each of {len(x)} pieces of evidence, got {len(y)}"
        )
    known = x.isfinite()
    x, y = x[known], y[known]
    count = int(y.sum())
    if not 0 < count < len(y):
        raise ValueError(
            f"same: expected pairs of both kinds, got {count} same and {len(y) - count} "
            "different ones with finite evidence"
        )
    return x, y, known


def logistic_regression(
    columns: Float[Tensor, "P c"], y: Float[Tensor, " P"], regularisation: float
) -> Float[Tensor, " c"]:
    """Minimise the mean log loss of logits ``columns @ w`` + regularisation / 2 * |w|² over w.

    Newton's method with step halving. The last column is the constant, whose weight is regularised
    just enough for the Hessian to be invertible.
    """
    penalty = torch.full_like(columns[0], regularisation)
    penalty[-1] = 1e-9

    def loss(weight: Tensor) -> Tensor:
        fit = binary_cross_entropy_with_logits(columns @ weight, y)
        return fit + (penalty * weight.square()).sum() / 2

    weight = torch.zeros_like(columns[0])
    weight[-1] = torch.logit(y.mean(), eps=1e-12)
    for _ in range(50):  # Newton's method takes about 10
        probability = torch.sigmoid(columns @ weight)
        gradient = columns.T @ (probability - y) / len(y) + penalty * weight
        variance = probability * (1 - probability)
        hessian = (columns.T * variance) @ columns / len(y) + torch.diag(penalty)
        step = torch.linalg.solve(hessian, gradient)
        size, now = 1.0, loss(weight)
        while size > 1e-6 and loss(weight - size * step) > now:
            size /= 2
        weight = weight - size * step
        if float(gradient.abs().max()) < 1e-10:
            break
    return weight
