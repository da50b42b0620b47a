"""Motion: whether one path leads through both."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.scoring import Calibrator, Scorer
from mixer_torch.tracking.motion import MotionModel, State, log_ratio
from mixer_torch.tracking.tracklets import PATH_FEATURES, with_paths
from scorers.calibration import Logistic


class Motion(Scorer):
    """Does an almost straight path through one arrive at the other, forwards and backwards?

    The evidence is a log likelihood ratio: the density with which the state from which the later
    one goes on is met by the path on which the earlier one had been
    (:func:`mixer_torch.tracking.motion.log_ratio`), against the density of strangers. Velocities
    are those that features ``exit`` and ``entry`` tell, which are fitted on nearby confident links
    (:func:`mixer_torch.tracking.tracklets.with_paths`); without them velocities are not known, and
    anything within the usual speed is as good. Prediction loses its certainty as time passes.

    It says nothing of things seen by different cameras, nor of those that overlap in time.

    Args:
        strangers: How many other things there are to take for it, per square height and nat.
        model: How things move; people walking if None.
        limit: Greatest log likelihood ratio for or against, nats.
        calibrator: Takes the place of the one set by hand; its evidence is the log likelihood
            ratio, nats.
    """

    needs = ("box", "time")

    def __init__(
        self,
        strangers: float = 0.1,
        weight: float = 1.0,
        fade: float = 0.0,
        patience: float = 0.2,
        limit: float = 5.0,
        model: MotionModel | None = None,
        calibrator: Calibrator | None = None,
    ) -> None:
        for name, value in (("strangers", strangers), ("limit", limit), ("patience", patience)):
            if not 0 < value < float("inf"):
                raise ValueError(f"{name}: expected a positive number, got {value}")
        super().__init__(calibrator or Logistic(1.0, 0.0))
        self.model = model or MotionModel()
        self.strangers = strangers
        self.weight = weight
        self.fade = fade
        self.patience = patience
        self.limit = limit

    def describe(self, observations: Observations) -> tuple[Tensor, ...]:
        """Times, states and cameras of both ends."""
        if any(key not in observations.features for key in PATH_FEATURES):
            alone = torch.arange(len(observations), device=observations.device)
            observations = with_paths(observations, alone, self.model)
        camera = observations.features.get("camera", torch.zeros_like(observations.view))
        return (*(observations[key] for key in PATH_FEATURES), camera)

    def compare(self, description: Any, pairs: Tensor) -> Tensor:
        span, entry, leaving, camera = description
        a, b = pairs
        first = span[a, 0] <= span[b, 0]
        a, b = torch.where(first, a, b), torch.where(first, b, a)
        seconds = span[b, 0] - span[a, 1]
        earlier, later = State.unpacked(leaving[a]), State.unpacked(entry[b])
        height = ((earlier.mean[:, 2, 0] + later.mean[:, 2, 0]) / 2).exp()
        ratio = log_ratio(earlier, later, seconds, height, self.model).sum(1)
        ratio = self.weight * (ratio - math.log(self.strangers)).clamp(-self.limit, self.limit)
        says = (seconds > 0) & (camera[a] == camera[b])
        ratio = ratio - self.fade * torch.log1p(seconds.clamp(min=0) / self.patience)
        return ratio.where(says, torch.nan)
