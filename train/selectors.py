"""Pairs for training that are as far apart in time as the pairs that will be scored."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Int64
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.pairs import PairSelector, Within


class AtGaps(PairSelector):
    """Pairs across views at given distances, at every offset.

    The likelihood ratio of evidence depends on the time between two sightings: overlap of two boxes
    says much after a tenth of a second and nothing after three. A video with every frame contains
    many sparsely sampled ones: its frames 1, 21, 41, ..., its frames 2, 22, 42, ..., and so on.

    Args:
        gaps: Distances, in the unit of the feature: seconds, or frames.
        feature: One number an observation, ``time`` or ``frame``.
        tolerance: Largest difference from one of the gaps.

    Raises:
        ValueError: There is no gap, one is not positive, or tolerance is negative.
    """

    def __init__(
        self, gaps: Sequence[float], feature: str = "time", tolerance: float = 0.05
    ) -> None:
        if not len(gaps) or not all(0 < gap < float("inf") for gap in gaps):
            raise ValueError(f"gaps: expected one or more positive numbers, got {list(gaps)}")
        if not tolerance >= 0:
            raise ValueError(f"tolerance: expected a number >= 0, got {tolerance}")
        self.gaps = tuple(gaps)
        self.feature = feature
        self.tolerance = tolerance

    def __call__(self, observations: Observations) -> Int64[Tensor, "2 P"]:
        pairs = Within(max(self.gaps) + self.tolerance, self.feature)(observations)
        value = observations[self.feature].double()
        apart = (value[pairs[0]] - value[pairs[1]]).abs()
        wanted = torch.zeros_like(apart, dtype=torch.bool)
        for gap in self.gaps:
            wanted |= (apart - gap).abs() <= self.tolerance
        return pairs[:, wanted]
