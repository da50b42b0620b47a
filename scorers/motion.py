"""Motion: whether one path leads through both."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.scorers.curves import Logistic
from mixer_torch.scoring import Calibrator, Scorer
from mixer_torch.tracking.motion import MotionModel
from mixer_torch.tracking.tracklets import PATH_FEATURES, path_log_ratio, without_paths

PATIENCE = 0.2  # seconds
SURE = 0.97  # confidence from which doubt counts, one way and the other


class Motion(Scorer):
    """Does an almost straight path through one arrive at the other, forwards and backwards?

    With r the log likelihood ratio of one path against two (the density with which the state from
    which the later one goes on is met by the path on which the earlier one had been, against that
    of strangers, :func:`mixer_torch.tracking.motion.log_ratio`), the evidence is

        max(0, x - y) + min(0, x),    x = weight * clamp(r, -limit, limit),
        y = prior + fade log(1 + dt / 0.2 s) + doubt log((1.02 - c) / 0.05),

    in nats: what speaks for one object must outweigh y, which grows with the time dt that it would
    not have been seen and with the doubt about the less confident of the two, of confidence c, as
    clutter is not continued. What is outweighed says nothing, not the contrary: an object is seen
    again at some time, so a gap alone is no evidence against it.

    Velocities are those that the features ``exit`` and ``entry`` tell, which are fitted on nearby
    confident links (:func:`mixer_torch.tracking.tracklets.with_paths`); without them velocities
    are not known, and anything within the usual speed is as good. It says nothing of things seen
    by different cameras, nor of those that overlap in time.

    Args:
        strangers: How many other things there are to take for it, per square height and nat.
        weight: Share of the log likelihood ratio that is believed; paths bend more than the model
            allows, and errors of neighbouring boxes are alike.
        limit: Greatest log likelihood ratio for or against, nats, before it is weighted.
        prior: Nats that have to be outweighed at once; negative where matches are expected.
        fade: Nats that have to be outweighed for each e-fold of the time not seen.
        doubt: Nats that have to be outweighed for each e-fold of 1.02 less the confidence.
        model: How things move; people walking if None.
        calibrator: Takes the place of the logistic function of the evidence.

    Raises:
        ValueError: strangers, weight or limit is not positive, or a number is not finite.
    """

    needs = ("box", "time")

    def __init__(
        self,
        strangers: float = 0.1,
        weight: float = 0.8,
        limit: float = 4.0,
        prior: float = 0.0,
        fade: float = 0.0,
        doubt: float = 0.0,
        model: MotionModel | None = None,
        calibrator: Calibrator | None = None,
    ) -> None:
        for name, value in (("strangers", strangers), ("weight", weight), ("limit", limit)):
            if not 0 < value < float("inf"):
                raise ValueError(f"{name}: expected a positive number, got {value}")
        for name, value in (("prior", prior), ("fade", fade), ("doubt", doubt)):
            if not abs(value) < float("inf"):
                raise ValueError(f"{name}: expected a finite number, got {value}")
        super().__init__(calibrator or Logistic(1.0, 0.0))
        self.strangers = strangers
        self.weight = weight
        self.limit = limit
        self.prior, self.fade, self.doubt = prior, fade, doubt
        self.model = model or MotionModel()

    def describe(self, observations: Observations) -> tuple[Tensor, ...]:
        """Times and states of both ends, cameras, and confidences."""
        if any(key not in observations.features for key in PATH_FEATURES):
            observations = without_paths(observations, self.model)
        camera = observations.camera
        sure = observations.features.get("confidence", torch.full_like(camera, 1.0).double())
        return (*(observations[key] for key in PATH_FEATURES), camera, sure.double())

    def compare(self, description: Any, pairs: Tensor) -> Tensor:
        span, entry, leaving, camera, sure = description
        ratio, seconds = path_log_ratio(span, entry, leaving, pairs, self.model)
        ratio = ratio - math.log(self.strangers)
        believed = self.weight * ratio.clamp(-self.limit, self.limit)
        a, b = pairs
        outweighed = (believed - self._burden(seconds, torch.minimum(sure[a], sure[b]))).clamp(
            min=0
        )
        says = (seconds > 0) & (camera[a] == camera[b])
        return (outweighed + believed.clamp(max=0)).where(says, torch.nan)

    def _burden(self, seconds: Tensor, sure: Tensor) -> Tensor:
        """What evidence for one object has to outweigh, nats."""
        doubt = torch.log((1.02 - sure.nan_to_num(SURE).clamp(0, 1)) / (1.02 - SURE))
        waiting = torch.log1p(seconds.clamp(min=0) / PATIENCE)
        return self.prior + self.fade * waiting + self.doubt * doubt
