"""From l scores a pair to one cost a pair."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn


class Fusion(nn.Module):
    """How scores of several modalities become the cost of calling a pair the same.

    Args:
        weights: Non-negative weight by name of modality; 1 where none is given.

    Raises:
        ValueError: A weight is negative or not finite.
    """

    def __init__(self, weights: Mapping[str, float] | None = None) -> None:
        super().__init__()
        self.weights = dict(weights or {})
        for name, weight in self.weights.items():
            if not 0 <= weight < float("inf"):
                raise ValueError(f"weights[{name!r}]: expected a finite number >= 0, got {weight}")

    def weight(
        self, scores: Float[Tensor, "l P"], modalities: Sequence[str]
    ) -> Float[Tensor, " l"]:
        """The weight of each modality; KeyError names a weight for none of them."""
        for name in self.weights:
            if name not in modalities:
                raise KeyError(
                    f"weights: no modality {name!r}; modalities: {', '.join(modalities)}"
                )
        weights = [self.weights.get(name, 1.0) for name in modalities]
        return torch.tensor(weights, dtype=scores.dtype).to(scores.device, non_blocking=True)

    def forward(
        self, scores: Float[Tensor, "l P"], modalities: Sequence[str]
    ) -> Float[Tensor, " P"]:
        """Weighted sum of the modalities' costs: negative attracts, 0 is indifferent."""
        cost = torch.zeros_like(scores[0])
        for weight, row in zip(self.weight(scores, modalities), scores, strict=True):
            cost = cost + weight * self.cost_of(row)
        return cost

    @abstractmethod
    def cost_of(self, score: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        """Cost of one modality's scores: decreasing, and 0 at 0.5."""


class LinearFusion(Fusion):
    """The paper's: cost = sum_k w_k (1 - 2 s_k), from the Frobenius objective of its eq. (1)."""

    def cost_of(self, score: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return 1 - 2 * score


class LogOddsFusion(Fusion):
    """Naive Bayes: cost = -sum_k w_k logit(s_k) - logit(p), the negative log posterior odds.

    The prior p applies to the pairs that are listed; one that is not costs 0. Below 0.5 it asks for
    more evidence before observations are joined, which is wanted where the errors of many pairs
    are alike: crops of two persons in one kind of coat are all alike, and their sum is not worth
    as much as that many independent pairs.

    Args:
        weights: Non-negative weight by name of modality; 1 where none is given.
        cap: Largest log likelihood ratio that one modality may claim, in nats, so that no score
            of 0 or 1 outvotes all others.
        prior: Probability that a pair shows one object, before anything is known of it.

    Raises:
        ValueError: cap is not positive, or prior not between 0 and 1.
    """

    def __init__(
        self,
        weights: Mapping[str, float] | None = None,
        cap: float = 4.0,
        prior: float = 0.5,
    ) -> None:
        super().__init__(weights)
        if not 0 < cap < float("inf"):
            raise ValueError(f"cap: expected a finite number > 0, got {cap}")
        if not 0 < prior < 1:
            raise ValueError(f"prior: expected a number between 0 and 1, got {prior}")
        self.cap = cap
        self.prior = prior

    def forward(
        self, scores: Float[Tensor, "l P"], modalities: Sequence[str]
    ) -> Float[Tensor, " P"]:
        return super().forward(scores, modalities) + math.log(1 / self.prior - 1)

    def cost_of(self, score: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return -torch.logit(score, eps=torch.finfo(score.dtype).eps).clamp(-self.cap, self.cap)
