"""Tracklets: what the frames between two sightings tell."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.scorers.curves import Logistic
from mixer_torch.scoring import Calibrator, Scorer
from mixer_torch.tracking.motion import MotionModel
from mixer_torch.tracking.tracklets import TRACKLET_FEATURES, path_log_ratio


class Tracklet(Scorer):
    """Of one tracklet, same object; of two that overlap in time, not; else by how one goes on.

    The evidence is in nats:

        limit + 1                       of one tracklet,
        -(limit + 1)                    of two tracklets of one camera that overlap in time,
        clamp(r - log strangers, limit) of others of one camera,

    with r the log likelihood ratio that one path leads from where the earlier tracklet ended to
    where the later one began (:func:`mixer_torch.tracking.motion.log_ratio`). It says nothing of
    different cameras, nor where a feature is NaN. The features are those of
    :class:`~mixer_torch.tracking.tracked.Tracked`. Tracklets are wrong now and then, so how much
    to believe is for the calibrator, at best one that was trained
    (``benchmarks/configs/learning_motion/train_tracklets.yaml``).

    Args:
        strangers: How many other things there are to take for it, per square height and nat.
        limit: Greatest log likelihood ratio of two tracklets, for or against, nats.
        model: How things move; people walking if None.
        calibrator: Takes the place of the logistic function of half the evidence.

    Raises:
        ValueError: strangers or limit is not positive.
    """

    needs = TRACKLET_FEATURES

    def __init__(
        self,
        strangers: float = 0.1,
        limit: float = 6.0,
        model: MotionModel | None = None,
        calibrator: Calibrator | None = None,
    ) -> None:
        for name, value in (("strangers", strangers), ("limit", limit)):
            if not 0 < value < float("inf"):
                raise ValueError(f"{name}: expected a positive number, got {value}")
        super().__init__(calibrator or Logistic(0.5, 0.0))
        self.strangers = strangers
        self.limit = limit
        self.model = model or MotionModel()

    def describe(self, observations: Observations) -> tuple[Tensor, ...]:
        """Tracklets, their times and states at both ends, cameras, and whether all is known."""
        camera = observations.camera
        tracklet, *path = (observations[key] for key in self.needs)
        known = torch.stack([value.flatten(1).isfinite().all(1) for value in path]).all(0)
        return (tracklet, *path, camera, known)

    def compare(self, description: Any, pairs: Tensor) -> Tensor:
        tracklet, span, entry, leaving, camera, known = description
        ratio, seconds = path_log_ratio(span, entry, leaving, pairs, self.model)
        evidence = (ratio - math.log(self.strangers)).clamp(-self.limit, self.limit)
        evidence = evidence.where(seconds > 0, -self.limit - 1)
        a, b = pairs
        evidence = evidence.where(tracklet[a] != tracklet[b], self.limit + 1)
        says = (camera[a] == camera[b]) & known[a] & known[b]
        return evidence.where(says, torch.nan)
