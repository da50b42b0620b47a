"""Local texture: SIFT keypoints in each box."""

from __future__ import annotations

from typing import Any, Literal

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.scorers.curves import PiecewiseLinear
from mixer_torch.scorers.sift_features import (
    KorniaKeypoints,
    OpenCVKeypoints,
    distance_of,
    keypoints_of,
)
from mixer_torch.scoring import Calibrator, Scorer

MEMORY = {"cpu": 1 << 22, "cuda": 1 << 26}
"""Similarities of descriptors held at a time, by kind of device: 16 and 256 MiB of float32."""


class SIFT(Scorer):
    """Same texture, same object: SIFT keypoints that match by Lowe's ratio test, both ways.

    Keypoints of the crops of a and b match where each is the other's nearest and one of them is
    nearer than ``ratio`` times its second nearest. The evidence is how many do. Few matches say
    nothing (0.5), as in the paper; many say that the two are the same; none is ever evidence
    against, because a turned or blurred object matches nothing, unless ``none`` is set.

    Args:
        backend: ``opencv``, on the CPU, or ``kornia``, on the device of the observations.
        keypoints: Most keypoints a crop, the strongest.
        contrast: Contrast threshold of the detector; lower finds more. Its scale is the
            backend's.
        enlarge: Crops whose longer side is shorter are enlarged to it, up to four times, pixels:
            a small crop has few keypoints at its own size.
        root: RootSIFT instead of SIFT.
        ratio: Of Lowe's test; lower is stricter.
        weak: As many matches say nothing yet. With 64 keypoints a crop, two different
            persons of PETS 2009 and TUD-Stadtmitte have as many by chance (the likelihood ratio is
            1 at 6 to 7).
        strong: As many matches and more have the greatest score.
        none: Score of no match at all between two crops that both have keypoints.
        calibrator: Takes the place of the one set by hand.

    Raises:
        ValueError: An argument is out of its range.
    """

    needs = ("images",)

    def __init__(
        self,
        backend: Literal["opencv", "kornia"] = "opencv",
        keypoints: int = 64,
        contrast: float = 0.03,
        enlarge: int = 200,
        root: bool = True,
        ratio: float = 0.8,
        weak: float = 6.0,
        strong: float = 14.0,
        none: float = 0.5,
        calibrator: Calibrator | None = None,
    ) -> None:
        if backend not in ("opencv", "kornia"):
            raise ValueError(f"backend: expected 'opencv' or 'kornia', got {backend!r}")
        if keypoints < 1 or enlarge < 1 or not 0 < ratio <= 1:
            raise ValueError(
                "keypoints, enlarge, ratio: expected positive numbers and ratio <= 1, "
                f"got {keypoints}, {enlarge}, {ratio}"
            )
        if not (0 < weak < strong and 0 <= none <= 0.5):
            raise ValueError(
                "weak, strong, none: expected 0 < weak < strong and 0 <= none <= 0.5, "
                f"got {weak}, {strong}, {none}"
            )
        super().__init__(calibrator or PiecewiseLinear([0.0, weak, strong], [none, 0.5, 0.98]))
        self.backend = backend
        self.keypoints = keypoints
        self.contrast = contrast
        self.enlarge = enlarge
        self.root = root
        self.ratio = ratio

    def describe(self, observations: Observations) -> tuple[Tensor, ...]:
        """(m, K, 128) unit descriptors, and (m,) how many of the K each crop has."""
        device = observations.device
        extract: Any = OpenCVKeypoints(self.keypoints, self.contrast, self.root)
        if self.backend == "kornia":
            extract = KorniaKeypoints(self.keypoints, self.contrast, self.root, device)
        descriptors, count = keypoints_of(observations.images, extract, self.enlarge)
        return descriptors.to(device), count.to(device)

    def compare(self, description: tuple[Tensor, ...], pairs: Tensor) -> Tensor:
        descriptors, count = description
        evidence = descriptors.new_full((pairs.shape[1],), torch.nan)
        needed = count[pairs].max(0).values
        order = torch.argsort(needed)
        # Pairs with similar numbers of keypoints are computed together, to waste little on padding.
        ends = needed[order].cpu()
        room = MEMORY.get(descriptors.device.type, MEMORY["cpu"])
        start = int((ends == 0).sum())
        while start < len(order):
            width = int(ends[min(start + 255, len(order) - 1)])
            stop = min(start + max(room // (width * max(width, 128)), 1), len(order))
            width = int(ends[stop - 1])
            chunk = order[start:stop]
            a, b = pairs[:, chunk]
            similarity = torch.bmm(descriptors[a, :width], descriptors[b, :width].transpose(1, 2))
            evidence[chunk] = count_matches(similarity, count[a], count[b], self.ratio)
            start = stop
        return evidence.masked_fill((count[pairs] == 0).any(0), torch.nan)


def count_matches(
    similarity: Float[Tensor, "P K K2"],
    count_a: Int64[Tensor, " P"],
    count_b: Int64[Tensor, " P"],
    ratio: float,
) -> Float[Tensor, " P"]:
    """How many keypoints of a and b match, of which the first ``count`` are real.

    Two match where each is nearest to the other and one of them passes Lowe's ratio test. A crop
    with a single keypoint has no second nearest to test against, and passes none.

    Args:
        similarity: Inner products of unit descriptors.
        count_a: Rows that are keypoints and not padding.
        count_b: Columns that are.
        ratio: Of nearest to second nearest distance.
    """
    real_a = torch.arange(similarity.shape[1], device=similarity.device) < count_a[:, None]
    real_b = torch.arange(similarity.shape[2], device=similarity.device) < count_b[:, None]
    if not bool(real_a.all() & real_b.all()):
        padding = ~(real_a[:, :, None] & real_b[:, None, :])
        similarity = similarity.masked_fill(padding, -torch.inf)
    to_b, passes_a = _nearest(similarity, 2, ratio)
    to_a, passes_b = _nearest(similarity, 1, ratio)
    mutual = to_a.gather(1, to_b) == torch.arange(to_b.shape[1], device=to_b.device)
    matches = real_a & mutual & (passes_a | passes_b.gather(1, to_b))
    return matches.sum(1).to(similarity.dtype)


def _nearest(
    similarity: Float[Tensor, "P K K2"], dim: int, ratio: float
) -> tuple[Int64[Tensor, "P Ka"], Bool[Tensor, "P Ka"]]:
    """Index of the nearest along an axis, and whether it passes Lowe's ratio test."""
    # Two maxima are several times as fast as one topk of 2.
    best, index = similarity.max(dim)
    second = similarity.scatter(dim, index.unsqueeze(dim), -torch.inf).amax(dim)
    return index, (distance_of(best) < ratio * distance_of(second)) & second.isfinite()
