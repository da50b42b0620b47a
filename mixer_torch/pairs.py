"""Which pairs of observations to compare."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from mixer_torch.observations import Observations


class PairSelector(ABC):
    """A rule that picks the pairs to compare: never within a view, the smaller index first."""

    @abstractmethod
    def __call__(self, observations: Observations) -> Int64[Tensor, "2 P"]:
        """(2, P) int64, each pair once, with ``pairs[0] < pairs[1]``, in lexicographic order."""


class Every(PairSelector):
    """Every pair across views. Their number grows with the square of m."""

    def __call__(self, observations: Observations) -> Int64[Tensor, "2 P"]:
        m = len(observations)
        pairs = torch.triu_indices(m, m, offset=1, device=observations.device)
        return pairs[:, ~within_view(observations.view, pairs)]


class Within(PairSelector):
    """Pairs across views that lie at most a window apart. Never looks at all pairs.

    Args:
        window: Largest difference, in the unit of the feature: frames, or seconds.
        feature: One number an observation, ``frame`` or ``time``.
    """

    def __init__(self, window: float, feature: str = "frame") -> None:
        if not window >= 0:
            raise ValueError(f"window: expected a number >= 0, got {window}")
        self.window = window
        self.feature = feature

    def __call__(self, observations: Observations) -> Int64[Tensor, "2 P"]:
        value, order = torch.sort(observations[self.feature].double(), stable=True)
        if value.ndim != 1:
            raise ValueError(f"feature: expected one number an observation, got {self.feature!r}")
        place = torch.arange(len(value), device=value.device)
        last = torch.searchsorted(value, value + self.window, right=True)
        count = (last - place - 1).clamp(min=0)
        first = torch.repeat_interleave(place, count)
        rank = torch.arange(len(first), device=value.device)
        offset = rank - torch.repeat_interleave(torch.cumsum(count, 0) - count, count)
        return canonical(order[torch.stack([first, first + 1 + offset])], observations.view)


class Nearest(PairSelector):
    """Each observation and its k nearest in a feature (Euclidean), among those of other views.

    Args:
        k: Neighbours an observation. A pair is taken if either names the other.
        feature: ``position``, ``embedding`` or any other; rows with NaN are in no pair.
        chunk: Rows whose distances are held at a time; memory is chunk x m.
    """

    def __init__(self, k: int, feature: str = "position", chunk: int = 1024) -> None:
        if k < 1 or chunk < 1:
            raise ValueError(f"k and chunk: expected integers >= 1, got {k} and {chunk}")
        self.k = k
        self.feature = feature
        self.chunk = chunk

    def __call__(self, observations: Observations) -> Int64[Tensor, "2 P"]:
        value = observations[self.feature].flatten(1) if len(observations) else torch.zeros(0, 1)
        keep = value.isfinite().all(1).nonzero()[:, 0]
        value, view = value[keep].float(), observations.view[keep]
        k, found = min(self.k, len(keep)), []
        for start in range(0, len(keep), self.chunk):
            rows = torch.arange(start, min(start + self.chunk, len(keep)), device=keep.device)
            distance = torch.cdist(value[rows], value)
            distance[(view[rows, None] == view) & (view >= 0)] = torch.inf
            distance[rows - start, rows] = torch.inf
            nearest = distance.topk(k, largest=False)
            row, column = nearest.values.isfinite().nonzero(as_tuple=True)
            found.append(torch.stack([keep[rows[row]], keep[nearest.indices[row, column]]]))
        pairs = torch.cat(found, 1) if found else keep.new_zeros(2, 0)
        return canonical(pairs, observations.view)


def within_view(view: Int64[Tensor, " m"], pairs: Int64[Tensor, "2 P"]) -> Bool[Tensor, " P"]:
    """Which pairs lie within one view (a negative view is no view)."""
    a, b = view[pairs]
    return (a == b) & (a >= 0)


def canonical(pairs: Int64[Tensor, "2 Q"], view: Int64[Tensor, " m"]) -> Int64[Tensor, "2 P"]:
    """Each pair once, smaller index first, in lexicographic order, none within a view."""
    low, high = pairs.min(0).values, pairs.max(0).values
    key = torch.unique(low * max(len(view), 1) + high)
    pairs = torch.stack([key // max(len(view), 1), key % max(len(view), 1)])
    return pairs[:, (pairs[0] != pairs[1]) & ~within_view(view, pairs)]
