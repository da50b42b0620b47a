"""Calibrators: from the raw evidence of a modality to a score, set by hand or fitted simply."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

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

        It solves, over slope w and offset b,

            minimise  mean log(1 + exp(-y (w z + b))) + regularisation / 2 * w^2,   y = +-1,

        by Newton's method, z being the standardised evidence. The offset then holds the log prior
        odds log(n_same / n_different) of the sample, which are taken off: what is left is the log
        likelihood ratio, whose sigmoid is the score.

        Args:
            evidence: (P,) raw evidence; NaN is left out.
            same: (P,) bool, whether the pair shows one object.
            floor: Least score of the calibrator.
            ceiling: Greatest score of the calibrator.
            regularisation: Keeps the slope finite where the two kinds do not overlap.

        Raises:
            ValueError: The lengths differ, or one of the two kinds is missing.
        """
        x = torch.as_tensor(evidence).detach().double().flatten()
        y = torch.as_tensor(same).to(x.device, torch.bool).flatten()
        if x.shape != y.shape:
            raise ValueError(
                f"same: expected one for each of {len(x)} pieces of evidence, got {len(y)}"
            )
        x, y = x[x.isfinite()], y[x.isfinite()]
        count = int(y.sum())
        if not 0 < count < len(y):
            raise ValueError(
                f"same: expected pairs of both kinds, got {count} same and "
                f"{len(y) - count} different ones with finite evidence"
            )
        centre, spread = x.mean(), x.std().clamp(min=1e-12)
        slope, offset = _logistic_regression((x - centre) / spread, y.double(), regularisation)
        offset = offset - torch.logit(y.double().mean())
        slope = torch.where(slope == 0, torch.full_like(slope, 1e-12), slope)
        midpoint = centre - offset / slope * spread
        return cls(float(slope / spread), float(midpoint), floor, ceiling)

    def extra_repr(self) -> str:
        return f"slope={self.slope:g}, midpoint={self.midpoint:g}"


def _logistic_regression(
    z: Float[Tensor, " P"], y: Float[Tensor, " P"], regularisation: float
) -> Float[Tensor, 2]:
    """Slope and offset, by Newton's method with step halving, from zero."""
    design = torch.stack([z, torch.ones_like(z)], 1)
    penalty = torch.diag(z.new_tensor([regularisation, 1e-9]))

    def loss(weight: Tensor) -> Tensor:
        logit = design @ weight
        fit = nn.functional.binary_cross_entropy_with_logits(logit, y)
        return fit + weight @ penalty @ weight / 2

    weight = z.new_zeros(2)
    for _ in range(100):
        probability = torch.sigmoid(design @ weight)
        gradient = design.T @ (probability - y) / len(y) + penalty @ weight
        curvature = (design.T * (probability * (1 - probability))) @ design / len(y) + penalty
        step = torch.linalg.solve(curvature, gradient)
        size, now = 1.0, loss(weight)
        while size > 1e-6 and loss(weight - size * step) > now:
            size /= 2
        weight = weight - size * step
        if float(gradient.abs().max()) < 1e-10:
            break
    return weight


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
        knots, scores = self.knots.to(evidence), self.scores.to(evidence)
        if len(knots) == 1:
            return scores.expand_as(evidence) + 0 * evidence
        right = torch.searchsorted(knots, evidence.detach()).clamp(1, len(knots) - 1)
        left = right - 1
        share = (evidence - knots[left]) / (knots[right] - knots[left])
        return torch.lerp(scores[left], scores[right], share.clamp(0, 1))
