"""Colour: the name of the dominant one, or how alike two distributions are."""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from mixer_torch.extras import require
from mixer_torch.observations import Observations
from mixer_torch.scorers.curves import Logistic
from mixer_torch.scoring import Calibrator, Scorer

GREY = "grey"
HUES = {
    "red": 15.0,
    "orange": 40.0,
    "yellow": 70.0,
    "green": 165.0,
    "blue": 265.0,
    "purple": 345.0,
}
"""Upper end of each hue, degrees, by the usual names of the colour circle; red goes around 0."""
NAMES = (GREY, *HUES, "black", "white")
SIZE = (32, 64)
"""Width and height, pixels, to which crops are resized: a convention, the shape of a person."""
FEW = 5
"""Zero vectors that are averaged into the mean: shrinkage, so that a few crops that are all alike
are not centred away. A convention."""


class Color(Scorer):
    """Same colour, same object: independent of time, blind to what is painted alike.

    ``semantic`` is the paper's: 1 where the names of the dominant colours agree, 0 where they do
    not, 0.5 where either is grey, which stands for inconclusive.

    ``histogram`` compares distributions over hue, saturation and brightness in horizontal parts
    (so that shirt and trousers do not mix), in which pixels near the vertical axis of the box weigh
    most (so that the background does not). With d the square roots of a crop's frequencies in all
    parts and c their mean over all observations (shrunk where there are few), the evidence is the
    cosine of d_a - c and d_b - c: subtracting what all have in common leaves two different objects
    at 0 on average, without labels, whatever the scene's light. On PETS 2009 and TUD-Stadtmitte the
    likelihood ratio is 1 at about 0.25, and its logarithm grows by 8 to 10 a unit. The default
    midpoint is 0.1 above, because clothes that are alike are so in every view: errors of many pairs
    are correlated.

    Args:
        mode: ``semantic`` or ``histogram``.
        parts: Horizontal parts, of the histogram.
        focus: Standard deviation of the weight across the box, as a share of its width.
        midpoint: Evidence of the histogram at which the score is 0.5.
        slope: Log likelihood ratio gained by a unit of that evidence, nats.
        min_pixels: Crops of fewer pixels are not compared.
        calibrator: Takes the place of the one set by hand (which passes on 0 and 1 in the
            semantic mode).

    Raises:
        ValueError: mode is another, parts or min_pixels is < 1, or focus is not positive.
    """

    needs = ("images",)
    chunk = 1 << 13

    def __init__(
        self,
        mode: Literal["semantic", "histogram"] = "semantic",
        parts: int = 4,
        focus: float = 0.12,
        midpoint: float = 0.35,
        slope: float = 8.0,
        min_pixels: int = 16,
        calibrator: Calibrator | None = None,
    ) -> None:
        if mode not in ("semantic", "histogram"):
            raise ValueError(f"mode: expected 'semantic' or 'histogram', got {mode!r}")
        if parts < 1 or min_pixels < 1 or not focus > 0:
            raise ValueError(
                "parts, min_pixels, focus: expected integers >= 1 and a positive number, "
                f"got {parts}, {min_pixels}, {focus}"
            )
        by_hand = Logistic(slope, midpoint, 0.02, 0.98) if mode == "histogram" else None
        super().__init__(calibrator or by_hand)
        self.mode = mode
        self.parts = parts
        self.focus = focus
        self.min_pixels = min_pixels

    def describe(self, observations: Observations) -> Tensor:
        """Semantic: (m,) index into ``NAMES``. Histogram: (m, d) centred unit vectors.

        A crop too small for a colour is grey, or NaN.
        """
        if self.mode == "semantic":
            return torch.tensor(
                [NAMES.index(name) for name in self.names(observations)],
                dtype=torch.int64,
                device=observations.device,
            )
        images = observations.images
        width = self.parts * HISTOGRAM_BINS
        found = np.full((len(observations), width), np.nan, dtype=np.float32)
        for i, crop in images.crops() if images is not None else ():
            if crop.shape[0] * crop.shape[1] >= self.min_pixels:
                found[i] = part_histograms(crop, self.parts, self.focus).ravel()
        return _centred(torch.from_numpy(found).to(observations.device))

    def names(self, observations: Observations) -> list[str]:
        """The name of the dominant colour of each observation; grey where inconclusive."""
        names = [GREY] * len(observations)
        images = observations.images
        for i, crop in images.crops() if images is not None else ():
            if crop.shape[0] * crop.shape[1] >= self.min_pixels:
                names[i] = dominant_color(crop)
        return names

    def compare(self, description: Tensor, pairs: Tensor) -> Tensor:
        a, b = description[pairs[0]], description[pairs[1]]
        if self.mode == "histogram":
            return (a * b).sum(1)
        inconclusive = (a == NAMES.index(GREY)) | (b == NAMES.index(GREY))
        return (a == b).float().masked_fill(inconclusive, torch.nan)


def _centred(histograms: Float[Tensor, "m d"]) -> Float[Tensor, "m d"]:
    known = histograms.isfinite().all(1)
    centre = histograms[known].sum(0) / (int(known.sum()) + FEW)
    return torch.nn.functional.normalize(histograms - centre, dim=1)


HUE_BINS, SATURATION_BINS, VALUE_BINS = 16, 4, 4
HISTOGRAM_BINS = HUE_BINS * SATURATION_BINS * VALUE_BINS


def part_histograms(
    crop: UInt8[np.ndarray, "height width 3"], parts: int, focus: float
) -> Float[np.ndarray, "parts bins"]:
    """Square roots of the frequencies of hue x saturation x value, in each part of a crop.

    Bins and parts overlap linearly: a pixel between two of them counts in both by its distance.
    """
    hsv = _hsv(crop)
    bins = np.zeros((parts, HUE_BINS, SATURATION_BINS, VALUE_BINS))
    height, width = hsv.shape[:2]
    across = np.exp(-(((np.arange(width) + 0.5) / width - 0.5) ** 2) / (2 * focus**2))
    rows = np.broadcast_to(((np.arange(height) + 0.5) / height)[:, None], (height, width))
    axes = (
        _soft_bins(rows, parts),
        _soft_bins(hsv[..., 0] / 360, HUE_BINS, circular=True),
        _soft_bins(hsv[..., 1], SATURATION_BINS),
        _soft_bins(hsv[..., 2], VALUE_BINS),
    )
    for corner in range(16):
        picked = [axis[(corner >> k) & 1] for k, axis in enumerate(axes)]
        weight = np.broadcast_to(across, (height, width)).copy()
        for _, share in picked:
            weight *= share
        np.add.at(bins, tuple(index for index, _ in picked), weight)
    weights = bins.reshape(parts, -1)
    return np.sqrt(weights / weights.sum(1, keepdims=True).clip(min=1e-12)).astype(np.float32)


def _soft_bins(
    value: np.ndarray, count: int, circular: bool = False
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """The two bins next to each value in [0, 1] and the share of each."""
    place = value * count - 0.5
    if not circular:
        place = place.clip(0, count - 1)
    low = np.floor(place).astype(int)
    share = place - low
    high = (low + 1) % count if circular else np.minimum(low + 1, count - 1)
    return (low % count, 1 - share), (high, share)


def dominant_color(
    crop: UInt8[np.ndarray, "height width 3"],
    chromatic_share: float = 0.25,
    achromatic_share: float = 0.5,
) -> str:
    """Name of the dominant colour in the middle of a crop.

    Pixels near the middle weigh most, saturated highlights nothing. A hue needs a smaller share
    than black or white do, because windows, tyres, shadow and asphalt are achromatic on objects of
    every colour. The thresholds on saturation and value are conventions.

    Args:
        crop: RGB.
        chromatic_share: Least share of the weight for red to purple.
        achromatic_share: Least share of the weight for black or white.
    """
    hsv = _hsv(crop)
    height, width = hsv.shape[:2]
    hue, saturation, value = hsv[..., 0], hsv[..., 1], hsv[..., 2]
    y = ((np.arange(height) + 0.5) / height - 0.5)[:, None]
    x = ((np.arange(width) + 0.5) / width - 0.5)[None]
    weight = np.exp(-(x**2 + y**2) / (2 * 0.2**2))
    weight = np.where((value > 0.98) & (saturation < 0.1), 0, weight) + 1e-9
    weight /= weight.sum()
    colourful = (saturation > 0.3) & (value > 0.2)
    kind = np.searchsorted(np.array(list(HUES.values())), hue.ravel(), side="right") % len(HUES)
    share = np.bincount(kind, (weight * colourful).ravel(), minlength=len(HUES))
    if share.max() >= chromatic_share:
        return list(HUES)[int(share.argmax())]
    black = float(weight[~colourful & (value <= 0.25)].sum())
    white = float(weight[(saturation < 0.15) & (value > 0.75)].sum())
    if max(black, white) >= achromatic_share:
        return "black" if black > white else "white"
    return GREY


def _hsv(crop: UInt8[np.ndarray, "height width 3"]) -> Float[np.ndarray, "64 32 3"]:
    """A crop, resized, as hue in degrees, saturation and value in [0, 1]."""
    cv2 = require("cv2", extra="vision")
    image = cv2.resize(np.ascontiguousarray(crop), SIZE, interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2HSV)
