"""Which pairs of observations to compare."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

import torch
from jaxtyping import Bool, Float64, Int64
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
        chunks = list(_nearby(observations[self.feature], self.feature, self.window, None))
        pairs = torch.cat(chunks, 1) if chunks else observations.view.new_zeros(2, 0)
        return canonical(pairs, observations.view)


class Reachable(PairSelector):
    """Pairs within a window of time whose boxes one object could have, if it moves plausibly.

    With h the geometric mean of the two heights, dt the time between them and d the distance of
    the middles of the boxes, a pair is taken if, in one camera,

        dt <= window,   d <= (reach + speed dt) h,   |log(h_a / h_b)| <= growth.

    Never looks at all pairs: time and memory are linear in the length of the sequence. Boxes with
    NaN are in no pair.

    Args:
        window: Longest time between the two, seconds.
        reach: What detections of one thing differ by at most, heights.
        speed: Greatest speed, heights a second.
        growth: Greatest difference of size, nats.
        views: Observations at most this many moments apart are compared even if that is longer
            than the window: sequences of few frames a second still have neighbours.
        most_views: Observations more than this many moments apart are never compared, so that
            their number does not grow with the frame rate; None for no limit.
        chunk: Pairs that are looked at together.

    Raises:
        ValueError: A number is negative, or chunk is not positive.
    """

    def __init__(
        self,
        window: float = 1.0,
        reach: float = 0.5,
        speed: float = 2.0,
        growth: float = 0.7,
        views: int = 1,
        most_views: int | None = None,
        chunk: int = 1 << 22,
    ) -> None:
        limits = {"window": window, "reach": reach, "speed": speed, "growth": growth}
        for name, value in (limits | {"views": views, "most_views": most_views or 0}).items():
            if not value >= 0:
                raise ValueError(f"{name}: expected a number >= 0, got {value}")
        if chunk < 1:
            raise ValueError(f"chunk: expected an integer >= 1, got {chunk}")
        self.window = window
        self.reach = reach
        self.speed = speed
        self.growth = growth
        self.views = views
        self.most_views = most_views
        self.chunk = chunk

    def __call__(self, observations: Observations) -> Int64[Tensor, "2 P"]:
        time, box = observations["time"].double(), observations["box"].double()
        camera = observations.camera
        moment = torch.unique(time, return_inverse=True)[1]
        height = (box[:, 3] - box[:, 1]).clamp(min=1.0)
        middle = (box[:, :2] + box[:, 2:]) / 2
        found = [observations.view.new_zeros(2, 0)]
        for a, b in _nearby(moment, "time", self._moments(time), self.chunk):
            seconds, apart = (time[a] - time[b]).abs(), (moment[a] - moment[b]).abs()
            near = (seconds <= self.window) | (apart <= self.views)
            if self.most_views is not None:
                near &= apart <= self.most_views
            limit = (self.reach + self.speed * seconds) * (height[a] * height[b]).sqrt()
            near &= torch.linalg.vector_norm(middle[a] - middle[b], dim=1) <= limit
            near &= (height[a] / height[b]).log().abs() <= self.growth
            found.append(torch.stack([a, b])[:, near & (camera[a] == camera[b])])
        return canonical(torch.cat(found, 1), observations.view)

    def _moments(self, time: Float64[Tensor, " m"]) -> int:
        """How many different moments lie in the window at most, at least ``views``."""
        moments = torch.unique(time)
        last = torch.searchsorted(moments, moments + self.window, right=True)
        place = torch.arange(len(moments), device=time.device)
        most = int((last - place - 1).max()) if len(moments) else 0
        most = max(most, self.views)
        return most if self.most_views is None else min(most, self.most_views)


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


def _nearby(
    feature: Tensor, name: str, window: float, chunk: int | None
) -> Iterator[Int64[Tensor, "2 Q"]]:
    """Pairs at most a window apart in a feature, about ``chunk`` of them at a time."""
    value, order = torch.sort(feature.double(), stable=True)
    if value.ndim != 1:
        raise ValueError(f"feature: expected one number an observation, got {name!r}")
    place = torch.arange(len(value), device=value.device)
    last = torch.searchsorted(value, value + window, right=True)
    count = (last - place - 1).clamp(min=0)
    done = torch.cumsum(count, 0)
    start = 0
    while start < len(value):
        before = int(done[start] - count[start])
        stop = len(value)
        if chunk is not None:
            stop = max(int(torch.searchsorted(done, before + chunk, right=True)), start + 1)
        here = count[start:stop]
        first = torch.repeat_interleave(place[start:stop], here)
        rank = torch.arange(len(first), device=value.device)
        offset = rank - torch.repeat_interleave(torch.cumsum(here, 0) - here, here)
        yield order[torch.stack([first, first + 1 + offset])]
        start = stop


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
