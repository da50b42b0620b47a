"""A first guess of who is who, frame by frame, as trackers do that know only the past."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Int64
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.tracking.motion import (
    MotionModel,
    State,
    axis_scale,
    box_position,
    first_state,
    log_ratio,
)


def causal_labels(
    observations: Observations,
    model: MotionModel,
    resolution: float,
    strangers: float = 0.1,
    patience: float = 0.5,
    backwards: bool = False,
) -> Int64[Tensor, " m"]:
    """Labels of boxes that are matched to the paths so far, one moment after the other.

    At each moment, minimise the sum of negative log likelihood ratios that a path goes on in a box
    (:func:`~mixer_torch.tracking.motion.log_ratio`, against ``strangers``) over the one-to-one
    assignments of paths to boxes, an unassigned one costing nothing. Assigned boxes move the
    path's Kalman filter on, the others begin paths, and paths that were not seen for longer than
    ``patience`` end. Each camera is looked at alone. Time is linear in the number of moments.

    What is decided here is never revised, so it is only a start: it tells velocities, with which
    the problem as a whole is then posed.

    Args:
        observations: With ``box`` and ``time``.
        model: How things move.
        resolution: Error of the detector, pixels.
        strangers: How many other things there are to take for it, per square height and nat.
        patience: Longest time that a path is not seen, seconds.
        backwards: From the last moment to the first.

    Returns:
        Any integers, one for each path.
    """
    position, height = box_position(observations["box"])
    time = observations["time"].double() * (-1 if backwards else 1)
    camera = observations.camera
    boxes = first_state(position, height, model, resolution)
    labels = torch.arange(len(observations), device=observations.device)
    for one in torch.unique(camera):
        rows = (camera == one).nonzero()[:, 0]
        rows = rows[torch.argsort(time[rows], stable=True)]
        paths = _Paths(boxes[rows[:0]], time[rows[:0]], rows[:0], height[rows[:0]])
        for group in rows.split(
            torch.unique_consecutive(time[rows], return_counts=True)[1].tolist()
        ):
            now = time[group[0]]
            paths = paths.recent(now - patience)
            seen = _Paths(boxes[group], time[group], labels[group], height[group])
            a, b = paths.matched(seen, model, strangers)
            labels[group[b]] = paths.label[a]
            paths = paths.updated(a, seen, b, labels[group], model)
    return labels


class _Paths:
    """Paths (or boxes, that are paths of one sight): states, times, labels and heights."""

    def __init__(self, state: State, time: Tensor, label: Tensor, height: Tensor) -> None:
        self.state, self.time, self.label, self.height = state, time, label, height

    def select(self, index: Tensor) -> _Paths:
        return _Paths(self.state[index], self.time[index], self.label[index], self.height[index])

    def recent(self, since: Tensor) -> _Paths:
        return self.select(self.time >= since - 1e-9)

    def matched(self, seen: _Paths, model: MotionModel, strangers: float) -> tuple[Tensor, Tensor]:
        """Indices of paths and of boxes that go together."""
        n, k = len(self.time), len(seen.time)
        a = torch.arange(n, device=self.time.device).repeat_interleave(k)
        b = torch.arange(k, device=self.time.device).repeat(n)
        height = (self.height[a] * seen.height[b]).sqrt()
        ratio = log_ratio(
            self.state[a], seen.state[b], seen.time[b] - self.time[a], height, model
        ).sum(1)
        gain = (ratio - math.log(strangers)).clamp(min=0).reshape(n, k).cpu().numpy()
        row, column = linear_sum_assignment(gain, maximize=True)
        good = gain[row, column] > 0
        found = torch.from_numpy(np.stack([row[good], column[good]]).astype(np.int64))
        return found[0].to(self.time.device), found[1].to(self.time.device)

    def updated(
        self, a: Tensor, seen: _Paths, b: Tensor, label: Tensor, model: MotionModel
    ) -> _Paths:
        """The paths after boxes ``b`` were seen on paths ``a``, and the new ones that begin."""
        jolt = (axis_scale(seen.height) * seen.height.new_tensor(model.jolt)).square()
        mean, spread = seen.state.mean.clone(), seen.state.spread.clone()
        moved = self.state[a].moved(seen.time[b] - self.time[a], jolt[b])
        after = moved.seen(mean[b, :, 0], spread[b, :, 0])
        mean[b], spread[b] = after.mean, after.spread
        left = torch.ones_like(self.time, dtype=torch.bool)
        left[a] = False
        old = self.select(left)
        return _Paths(
            State(torch.cat([old.state.mean, mean]), torch.cat([old.state.spread, spread])),
            torch.cat([old.time, seen.time]),
            torch.cat([old.label, label]),
            torch.cat([old.height, seen.height]),
        )
