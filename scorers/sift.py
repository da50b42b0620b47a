"""Local texture: SIFT keypoints in each box, or SIFT at a given point."""

from __future__ import annotations

from typing import Any, Literal

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from mixer_torch.observations import Observations, distinct_views
from mixer_torch.scorers.calibration import Logistic, PiecewiseLinear
from mixer_torch.scorers.sift_features import (
    KorniaKeypoints,
    OpenCVKeypoints,
    keypoints_of,
    points_of,
)
from mixer_torch.scoring import Calibrator, Scorer

MEMORY = {"cpu": 1 << 22, "cuda": 1 << 26}
"""Similarities of descriptors held at a time, by kind of device."""


class SIFT(Scorer):
    """Same texture, same object: SIFT keypoints that match by Lowe's ratio test, both ways.

    ``at="box"``: keypoints of the crops of a and b match where each is the other's nearest and one
    of them is nearer than ``ratio`` times its second nearest. The evidence is how many do. Few
    matches say nothing (0.5), as in the paper; many say that the two are the same; none is ever
    evidence against, because a turned or blurred object matches nothing, unless ``none`` is set.

    ``at="point"``: one descriptor an observation, at the feature ``point`` of its frame. The
    evidence is the log of the ratio test against the best rival in the other's view: with
    descriptor distance d and r(a; b) the one nearest to a among those in b's view other than b,

        min(log d(a, r(a; b)) - log d(a, b),  log d(b, r(b; a)) - log d(a, b)),

    positive where a and b are mutual nearest neighbours. A rival is never further than
    ``stranger``, which stands in where a view holds no other point.

    Args:
        at: ``box`` or ``point``.
        backend: ``opencv``, on the CPU, or ``kornia``, on the device of the observations (at
            boxes).
        keypoints: Most keypoints a crop, the strongest.
        contrast: Contrast threshold of the detector; lower finds more. Its scale is the
            backend's.
        enlarge: Crops whose longer side is shorter are enlarged to it, up to four times, pixels:
            a small crop has few keypoints at its own size.
        root: RootSIFT instead of SIFT.
        ratio: Of Lowe's test; lower is stricter.
        weak: As many matches say nothing yet. With 64 keypoints a crop, two strangers of PETS
            2009 and TUD-Stadtmitte have as many by chance (the likelihood ratio is 1 at 6 to 7).
        strong: As many matches and more have the greatest score.
        none: Score of no match at all between two crops that both have keypoints.
        size: Diameter of the neighbourhood of a point, pixels.
        stranger: Distance of unit descriptors of unrelated points.
        calibrator: Takes the place of the one set by hand.

    Raises:
        ValueError: An argument is out of its range, or kornia is asked for at points.
    """

    def __init__(
        self,
        at: Literal["box", "point"] = "box",
        backend: Literal["opencv", "kornia"] = "opencv",
        keypoints: int = 64,
        contrast: float = 0.03,
        enlarge: int = 200,
        root: bool = True,
        ratio: float = 0.8,
        weak: float = 6.0,
        strong: float = 14.0,
        none: float = 0.5,
        size: float = 24.0,
        stranger: float = 1.0,
        calibrator: Calibrator | None = None,
    ) -> None:
        if at not in ("box", "point"):
            raise ValueError(f"at: expected 'box' or 'point', got {at!r}")
        if backend not in ("opencv", "kornia") or (at == "point" and backend == "kornia"):
            raise ValueError(
                f"backend: expected 'opencv', or 'kornia' at boxes, got {backend!r} at {at!r}"
            )
        if keypoints < 1 or enlarge < 1 or not (0 < ratio <= 1 and size > 0 and stranger > 0):
            raise ValueError(
                "keypoints, enlarge, ratio, size, stranger: expected positive numbers and "
                f"ratio <= 1, got {keypoints}, {enlarge}, {ratio}, {size}, {stranger}"
            )
        if not (0 < weak < strong and 0 <= none <= 0.5):
            raise ValueError(
                "weak, strong, none: expected 0 < weak < strong and 0 <= none <= 0.5, "
                f"got {weak}, {strong}, {none}"
            )
        by_hand: Calibrator = Logistic(10.0, 0.0, 0.02, 0.98)
        if at == "box":
            by_hand = PiecewiseLinear([0.0, weak, strong], [none, 0.5, 0.98])
        super().__init__(calibrator or by_hand)
        self.needs = ("images",) if at == "box" else ("images", "point")
        self.at = at
        self.backend = backend
        self.keypoints = keypoints
        self.contrast = contrast
        self.enlarge = enlarge
        self.root = root
        self.ratio = ratio
        self.size = size
        self.stranger = stranger

    def describe(self, observations: Observations) -> tuple[Tensor, ...]:
        """At boxes: (m, K, 128) descriptors and (m,) how many each has. At points: (m, 128)
        descriptors, (m,) views, and (m, views) nearest and second nearest in each view.
        """
        device = observations.device
        if self.at == "point":
            point = observations["point"].detach().cpu().numpy()
            described = points_of(observations.images, point, self.size, self.root).to(device)
            view = distinct_views(observations.view)
            return described, view, *nearest_in_views(described, view)
        extract: Any = OpenCVKeypoints(self.keypoints, self.contrast, self.root)
        if self.backend == "kornia":
            extract = KorniaKeypoints(self.keypoints, self.contrast, self.root, device)
        descriptors, count = keypoints_of(observations.images, extract, self.enlarge)
        return descriptors.to(device), count.to(device)

    def compare(self, description: tuple[Tensor, ...], pairs: Tensor) -> Tensor:
        if self.at == "point":
            return self._compare_points(description, pairs)
        descriptors, count = description
        evidence = descriptors.new_full((pairs.shape[1],), torch.nan)
        needed = count[pairs].max(0).values
        order = torch.argsort(needed)
        # Pairs of few keypoints go together, so that little is computed on padding.
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

    def _compare_points(self, description: tuple[Tensor, ...], pairs: Tensor) -> Tensor:
        descriptors, view, nearest, second, which = description
        a, b = pairs
        distance = _distance((descriptors[a] * descriptors[b]).sum(1))
        margins = []
        for one, other in ((a, b), (b, a)):
            place = (one, view[other])
            rival = torch.where(which[place] == other, second[place], nearest[place])
            margins.append(_distance(rival).clamp(max=self.stranger).log() - distance.log())
        return torch.minimum(*margins)


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
    return index, (_distance(best) < ratio * _distance(second)) & second.isfinite()


def _distance(similarity: Tensor) -> Tensor:
    """Euclidean distance of unit vectors from their inner product."""
    return (2 - 2 * similarity).clamp(min=1e-12).sqrt()


def nearest_in_views(
    descriptors: Float[Tensor, "m d"], view: Int64[Tensor, " m"]
) -> tuple[Float[Tensor, "m views"], Float[Tensor, "m views"], Int64[Tensor, "m views"]]:
    """The greatest and second greatest similarity to each observation within each view, and which
    has the greatest; -inf where there is none. Nothing is its own neighbour.
    """
    m, views = len(view), int(view.max()) + 1 if len(view) else 0
    nearest = descriptors.new_full((m, views), -torch.inf)
    second, which = nearest.clone(), view.new_full((m, views), -1)
    known = descriptors.isfinite().all(1)
    for number in range(views):
        members = ((view == number) & known).nonzero()[:, 0]
        if not len(members):
            continue
        similarity = descriptors.nan_to_num() @ descriptors[members].T
        similarity[members, torch.arange(len(members), device=members.device)] = -torch.inf
        best = similarity.topk(min(2, len(members)), dim=1)
        nearest[:, number] = best.values[:, 0]
        which[:, number] = members[best.indices[:, 0]]
        if len(members) > 1:
            second[:, number] = best.values[:, 1]
    return nearest, second, which
