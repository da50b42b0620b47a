"""Covariates: the context in which a pair was compared, as a few numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from mixer_torch.observations import Observations

Features = Mapping[str, Tensor]


def _time_gap(features: Features, a: Tensor, b: Tensor) -> Tensor:
    return torch.log1p((features["time"][a] - features["time"][b]).abs())


def _frame_gap(features: Features, a: Tensor, b: Tensor) -> Tensor:
    return torch.log1p((features["frame"][a] - features["frame"][b]).abs().double())


def _heights(features: Features) -> Tensor:
    return (features["box"][:, 3] - features["box"][:, 1]).clamp(min=1e-3).log()


def _box_size(features: Features, a: Tensor, b: Tensor) -> Tensor:
    height = _heights(features)
    return torch.minimum(height[a], height[b])


def _size_ratio(features: Features, a: Tensor, b: Tensor) -> Tensor:
    height = _heights(features)
    return (height[a] - height[b]).abs()


def _confidence(features: Features, a: Tensor, b: Tensor) -> Tensor:
    return torch.minimum(features["confidence"][a], features["confidence"][b])


def _same_camera(features: Features, a: Tensor, b: Tensor) -> Tensor:
    return (features["camera"][a] == features["camera"][b]).double()


def _camera_pair(features: Features, a: Tensor, b: Tensor) -> Tensor:
    camera = features["camera"].long()
    low, high = torch.minimum(camera[a], camera[b]), torch.maximum(camera[a], camera[b])
    # Cantor's pairing: another number for each unordered pair, exact in float64.
    return (((low + high) * (low + high + 1)) // 2 + high).double().where(low >= 0, torch.nan)


COVARIATES: Mapping[str, tuple[str, Callable[[Features, Tensor, Tensor], Tensor]]] = {
    "time_gap": ("time", _time_gap),
    "frame_gap": ("frame", _frame_gap),
    "box_size": ("box", _box_size),
    "size_ratio": ("box", _size_ratio),
    "confidence": ("confidence", _confidence),
    "same_camera": ("camera", _same_camera),
    "camera_pair": ("camera", _camera_pair),
}
"""By name: the feature that is read, and the function that gives each pair a number.

- ``time_gap``: log(1 + seconds) between the sightings; ``frame_gap``: log(1 + frames).
- ``box_size``: log of the height of the smaller box, pixels.
- ``size_ratio``: absolute value of the log of the ratio of the heights.
- ``confidence``: the lower one of the detector.
- ``same_camera``: 1 within a camera, 0 across.
- ``camera_pair``: a number for each unordered pair of cameras; categorical."""

CATEGORICAL = ("camera_pair",)
"""Covariates whose values are names and no quantities: each value has a column of its own."""
LEVELS = 16
"""Values of a categorical covariate that are told apart, the most frequent ones in training."""
KINKS = (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5)
"""Where the base rate's piecewise linear functions of a standardised covariate may bend."""
CLIP = 3.0
"""Standard deviations from the mean within which covariates are kept."""


class Covariates(nn.Module):
    """Covariates of pairs by name, standardised on the pairs that training saw.

    A quantity becomes two columns: its standardised value z, clipped to ±3, and max(z, 0), so that
    a linear function of the columns can bend once. A categorical one becomes a column of 0 and 1
    for each of the :data:`LEVELS` values that were most frequent in training. What is not known
    counts as average.

    Args:
        names: Keys of :data:`COVARIATES`.

    Raises:
        ValueError: There is no covariate of that name, or one is named twice.
    """

    mean: Tensor
    std: Tensor
    lowest: Tensor
    highest: Tensor
    levels: Tensor

    def __init__(self, names: Sequence[str] = ()) -> None:
        super().__init__()
        for name in names:
            if name not in COVARIATES:
                raise ValueError(
                    f"covariates: expected some of {', '.join(COVARIATES)}, got {name!r}"
                )
        if len(set(names)) != len(names):
            raise ValueError(f"covariates: expected different names, got {list(names)}")
        self.names = tuple(names)
        self.needs = tuple(dict.fromkeys(COVARIATES[name][0] for name in names))
        for buffer, value in (("mean", 0.0), ("std", 1.0), ("lowest", 0.0), ("highest", 0.0)):
            full = torch.full((len(names),), value, dtype=torch.float64)
            self.register_buffer(buffer, full)
        self._categorical = [k for k, name in enumerate(names) if name in CATEGORICAL]
        self._numeric = [k for k, name in enumerate(names) if name not in CATEGORICAL]
        if self._categorical:
            self.mean[self._categorical] = torch.nan  # names have no mean: "not known"
            full = torch.full((len(self._categorical), LEVELS), torch.nan, dtype=torch.float64)
            self.register_buffer("levels", full)

    @property
    def width(self) -> int:
        """Number of :meth:`columns`."""
        return 2 * len(self._numeric) + LEVELS * len(self._categorical)

    def __len__(self) -> int:
        return len(self.names)

    def describe(self, observations: Observations) -> Features:
        """The features that are read."""
        return {key: observations[key] for key in self.needs}

    def of(self, features: Features, pairs: Int64[Tensor, "2 P"]) -> Float[Tensor, "P c"]:
        """Raw values (P, c) float64 of pairs; NaN where not known."""
        a, b = pairs
        columns = [COVARIATES[name][1](features, a, b).double() for name in self.names]
        return torch.stack(columns, 1) if columns else pairs.new_zeros(len(a), 0).double()

    def learn(self, values: Float[Tensor, "P c"]) -> None:
        """Take mean, spread and range, or the frequent levels, from raw values of training."""
        for row, k in enumerate(self._categorical):
            known = values[:, k][values[:, k].isfinite()]
            level, count = torch.unique(known, return_counts=True)
            frequent = level[torch.argsort(count, descending=True, stable=True)][:LEVELS]
            self.levels[row] = torch.nan
            self.levels[row, : len(frequent)] = frequent
        for k in self._numeric:
            known = values[:, k][values[:, k].isfinite()]
            if len(known):
                self.mean[k] = known.mean()
                self.std[k] = known.std(correction=0).clamp(min=1e-9)
                self.lowest[k], self.highest[k] = known.min(), known.max()

    def columns(self, values: Float[Tensor, "P c"]) -> Float[Tensor, "P w"]:
        """Columns (P, :attr:`width`) of raw values."""
        z = self._standardised(values)
        return torch.cat([z, z.clamp(min=0), *self._indicators(values)], 1)

    def base_columns(self, values: Float[Tensor, "P c"]) -> Float[Tensor, "P k"]:
        """Columns for the base rate: bends at each of :data:`KINKS`, and last a constant."""
        z = self._standardised(values)
        bent = [(z - kink).clamp(min=0) for kink in KINKS]
        one = values.new_ones(len(values), 1)
        return torch.cat([z, *bent, *self._indicators(values), one], 1)

    def _standardised(self, values: Float[Tensor, "P c"]) -> Float[Tensor, "P n"]:
        k = self._numeric
        z = (values[:, k] - self.mean[k]) / self.std[k]
        return z.clamp(-CLIP, CLIP).nan_to_num(0.0)

    def _indicators(self, values: Float[Tensor, "P c"]) -> list[Tensor]:
        """(P, LEVELS) of each categorical covariate: 1 where it has that value."""
        return [
            (values[:, k, None] == self.levels[row]).to(values)
            for row, k in enumerate(self._categorical)
        ]

    def support(self, values: Float[Tensor, "P c"]) -> Float[Tensor, " P"]:
        """1 within the range that training saw, falling to 0 outside of it; 0 for new levels."""
        within = [support(values[:, k], self.lowest[k], self.highest[k]) for k in self._numeric]
        for k, found in zip(self._categorical, self._indicators(values), strict=True):
            within.append(found.any(1).to(values).where(~values[:, k].isnan(), values.new_ones(())))
        return torch.stack([values.new_ones(len(values)), *within]).amin(0)


def support(value: Tensor, lowest: Tensor, highest: Tensor) -> Tensor:
    """1 from lowest to highest, and exp(-3 x) at x times that range outside of it; 1 for NaN.

    The 3 is a convention: of the log likelihood ratio, 5 % is left one range beyond training.
    """
    outside = torch.maximum(lowest - value, value - highest).clamp(min=0)
    share = outside / (highest - lowest).clamp(min=1e-9)
    return torch.exp(-3 * share).nan_to_num(1.0)
