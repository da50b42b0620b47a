"""Overlap of bounding boxes."""

from __future__ import annotations

import torch
from torch import Tensor

from mixer_torch.boxes import paired_iou
from mixer_torch.observations import Observations
from mixer_torch.scorers.curves import PiecewiseLinear
from mixer_torch.scoring import Calibrator, Scorer


class IoU(Scorer):
    """Same place in the picture a moment later, same object: intersection over union of boxes.

    It speaks only of temporally consecutive views of one camera (section IV of the paper); of all
    others it says nothing. Set by hand, the score runs from ``disjoint`` at no overlap, through 0.5
    at ``indifferent``, to ``ceiling`` at an overlap of ``sure`` and above.

    Args:
        max_gap: Views at most this far apart are consecutive, in the unit of ``feature``.
        feature: What consecutive is measured in: ``frame``, or ``time`` in seconds.
        disjoint: Score of boxes that do not overlap: the share of one object's sightings in
            consecutive views that do not overlap, against that of two objects, as LR / (1 + LR).
            Near 0 where objects cannot move by their own size in between, near 0.5 where most do.
        indifferent: Overlap at which the score is 0.5.
        sure: Overlap from which on the score is ``ceiling``.
        ceiling: Greatest score; two objects may pass each other, so it is not 1.
        calibrator: Takes the place of the one set by hand; its evidence is the IoU in [0, 1].

    Raises:
        ValueError: max_gap is negative, or not 0 <= disjoint <= 0.5 <= ceiling <= 1, or not
            0 < indifferent < sure <= 1.
    """

    def __init__(
        self,
        max_gap: float = 1.0,
        feature: str = "frame",
        disjoint: float = 0.3,
        indifferent: float = 0.1,
        sure: float = 0.6,
        ceiling: float = 0.98,
        calibrator: Calibrator | None = None,
    ) -> None:
        if not max_gap >= 0:
            raise ValueError(f"max_gap: expected a number >= 0, got {max_gap}")
        if not 0 <= disjoint <= 0.5 <= ceiling <= 1:
            raise ValueError(
                "disjoint, ceiling: expected 0 <= disjoint <= 0.5 <= ceiling <= 1, "
                f"got {disjoint}, {ceiling}"
            )
        if not 0 < indifferent < sure <= 1:
            raise ValueError(
                f"indifferent, sure: expected 0 < indifferent < sure <= 1, "
                f"got {indifferent}, {sure}"
            )
        super().__init__(
            calibrator or PiecewiseLinear([0.0, indifferent, sure], [disjoint, 0.5, ceiling])
        )
        self.max_gap = max_gap
        self.needs = ("box", feature)

    def describe(self, observations: Observations) -> tuple[Tensor, Tensor, Tensor]:
        """Boxes, moments, and cameras (all one where the observations do not name any)."""
        box, moment = (observations[key] for key in self.needs)
        if moment.ndim != 1:
            raise ValueError(f"feature: expected one number an observation, got {self.needs[1]!r}")
        camera = observations.camera
        return box, moment, camera

    def compare(self, description: tuple[Tensor, Tensor, Tensor], pairs: Tensor) -> Tensor:
        box, moment, camera = description
        a, b = pairs
        consecutive = (moment[a] - moment[b]).abs() <= self.max_gap
        consecutive = consecutive & (camera[a] == camera[b])
        return paired_iou(box[a], box[b]).where(consecutive, box.new_tensor(torch.nan))
