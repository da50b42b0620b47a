"""Where things were, and how they moved, at the two ends of a stretch of time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.tracking.kalman import filter_each

FLAT = 1e4  # variance of a velocity that is not known, in units of that of velocities
AXES = 3  # horizontal, vertical, and logarithm of the height


@dataclass(frozen=True)
class MotionModel:
    """Boxes of things that move at an almost constant velocity, in units of their own height.

    The middle of a box and the logarithm of its height are a path x(t) on each of three axes, with
    a velocity that is disturbed by white noise, seen with an error:

        dx = v dt,   dv ~ N(0, jolt^2 dt),   z = x + e,   e ~ N(0, error^2).

    The units are heights of the box for the two axes of the picture, nats for the third, and
    seconds. People of all sequences then look alike, whatever the camera and the frame rate.

    A detector errs by a share of the height and by a number of pixels, its ``resolution``, which
    is measured on the sequence itself (:func:`resolution`): e^2 = error^2 + (blur * resolution)^2.

    Args:
        error: Standard deviation of where a box is as a share of its height, on each axis.
        blur: The same in units of the resolution: pixels, pixels, pixels of the height.
        speed: Standard deviation of velocities, a second, on each axis.
        jolt: Standard deviation by which a velocity changes in a second, on each axis.

    Raises:
        ValueError: A number is not positive and finite, or there are not three of them.
    """

    error: tuple[float, float, float] = (0.01, 0.015, 0.035)
    blur: tuple[float, float, float] = (1.0, 1.25, 1.75)
    speed: tuple[float, float, float] = (0.5, 0.1, 0.16)
    jolt: tuple[float, float, float] = (0.2, 0.05, 0.08)

    def __post_init__(self) -> None:
        for name in ("error", "blur", "speed", "jolt"):
            value = tuple(float(x) for x in getattr(self, name))
            object.__setattr__(self, name, value)
            if len(value) != AXES or not all(0 < x < float("inf") for x in value):
                raise ValueError(f"{name}: expected {AXES} positive numbers, got {value}")


@dataclass(frozen=True)
class State:
    """Gaussian estimates of n things on three axes, each of a position and a velocity.

    Args:
        mean: (n, 3, 2) position and velocity.
        spread: (n, 3, 3) their covariance: of position, of both, of velocity.
    """

    mean: Float[Tensor, "n 3 2"]
    spread: Float[Tensor, "n 3 3"]

    def __getitem__(self, index: Tensor) -> State:
        return State(self.mean[index], self.spread[index])

    @property
    def packed(self) -> Float[Tensor, "n 3 5"]:
        """Mean and spread in one tensor, as a feature of observations."""
        return torch.cat([self.mean, self.spread], -1)

    @classmethod
    def unpacked(cls, packed: Float[Tensor, "n 3 5"]) -> State:
        """What :attr:`packed` was made of."""
        return cls(packed[..., :2], packed[..., 2:])

    def moved(self, seconds: Float[Tensor, " n"], noise: Float[Tensor, "n 3"]) -> State:
        """The estimate some seconds on (before, if negative); noise is the variance of jolts."""
        dt = seconds[:, None]
        position, velocity = self.mean.unbind(-1)
        pp, pv, vv = self.spread.unbind(-1)
        far = dt.abs()
        return State(
            torch.stack([position + velocity * dt, velocity], -1),
            torch.stack(
                [
                    pp + 2 * dt * pv + dt**2 * vv + noise * far**3 / 3,
                    pv + dt * vv + noise * dt * far / 2,
                    vv + noise * far,
                ],
                -1,
            ),
        )

    def seen(self, position: Float[Tensor, "n 3"], variance: Float[Tensor, "n 3"]) -> State:
        """The estimate after a position was measured (the update of a Kalman filter)."""
        pp, pv, vv = self.spread.unbind(-1)
        total = pp + variance
        surprise = position - self.mean[..., 0]
        return State(
            torch.stack(
                [
                    self.mean[..., 0] + pp / total * surprise,
                    self.mean[..., 1] + pv / total * surprise,
                ],
                -1,
            ),
            torch.stack([pp * variance / total, pv * variance / total, vv - pv**2 / total], -1),
        )

    def slowed(self, variance: Float[Tensor, "n 3"]) -> State:
        """The estimate after it was told that velocities are of mean 0 and this variance."""
        pp, pv, vv = self.spread.unbind(-1)
        total = vv + variance
        surprise = -self.mean[..., 1]
        return State(
            torch.stack(
                [
                    self.mean[..., 0] + pv / total * surprise,
                    self.mean[..., 1] + vv / total * surprise,
                ],
                -1,
            ),
            torch.stack([pp - pv**2 / total, pv * variance / total, vv * variance / total], -1),
        )


def box_position(box: Float[Tensor, "m 4"]) -> tuple[Tensor, Tensor]:
    """Positions (m, 3) on the three axes and heights (m,), pixels, of boxes x1 y1 x2 y2."""
    box = box.double()
    height = (box[:, 3] - box[:, 1]).clamp(min=1.0)
    middle = (box[:, :2] + box[:, 2:]) / 2
    return torch.cat([middle, height.log()[:, None]], 1), height


def axis_scale(height: Float[Tensor, " m"]) -> Float[Tensor, "m 3"]:
    """What one unit of the motion model is on each axis: pixels, pixels, nats."""
    return torch.stack([height, height, torch.ones_like(height)], 1)


def measured(
    height: Float[Tensor, " m"], model: MotionModel, resolution: float
) -> Float[Tensor, "m 3"]:
    """Variances of the measured positions of boxes, in pixels and nats."""
    share = height[:, None] * height.new_tensor(model.error)
    blur = resolution * height.new_tensor(model.blur)
    return (share.square() + blur.square()) * (axis_scale(height) / height[:, None]).square()


def first_state(
    position: Float[Tensor, "m 3"],
    height: Float[Tensor, " m"],
    model: MotionModel,
    resolution: float,
) -> State:
    """What one box tells: where it is, and next to nothing of its velocity."""
    speed = (axis_scale(height) * height.new_tensor(model.speed)).square()
    error = measured(height, model, resolution)
    none = torch.zeros_like(position)
    return State(torch.stack([position, none], -1), torch.stack([error, none, FLAT * speed], -1))


def resolution(
    position: Float[Tensor, "m 3"],
    height: Float[Tensor, " m"],
    time: Float[Tensor, " m"],
    label: Int64[Tensor, " m"],
    model: MotionModel,
) -> float:
    """By how many pixels a detector errs, from how boxes of one label jump from view to view.

    Of three successive boxes at equal steps in time, the second difference of what is measured
    with a standard deviation s has sqrt(6) s. The median of its size is taken over the horizontal
    axis, without the share that is proportional to the height.
    Without three such boxes it is 3 % of the median height.
    """
    position, height = position.detach(), height.detach()
    before = history(label, time, 2)
    c = (before >= 0).all(1).nonzero()[:, 0]
    b, a = before[c].unbind(1)
    first, second = time[b] - time[a], time[c] - time[b]
    even = (first > 0) & ((first - second).abs() < 0.01 * first)
    a, b, c = a[even], b[even], c[even]
    if len(c) < 20:
        return 0.03 * float(height.median()) if len(height) else 1.0
    jump = (position[a, 0] - 2 * position[b, 0] + position[c, 0]).square() / 6
    share = (model.error[0] * height[b]).square()
    return float((jump / 0.455 - share).median().clamp(min=0.04).sqrt())


def history(
    label: Int64[Tensor, " m"], time: Float[Tensor, " m"], memory: int
) -> Int64[Tensor, "m K"]:
    """The up to ``memory`` observations of the same label before each one, latest first; -1 none.

    Of observations of one label at one time, the one of the smaller index counts as earlier.
    """
    order = torch.argsort(time, stable=True)
    order = order[torch.argsort(label[order], stable=True)]
    place = torch.arange(len(label), device=label.device)
    back = place[:, None] - 1 - torch.arange(memory, device=label.device)
    inside = back >= 0
    back = back.clamp(min=0)
    inside &= label[order][back] == label[order][:, None]
    before = torch.empty_like(back)
    before[order] = torch.where(inside, order[back], -1)
    return before


def filtered(
    position: Float[Tensor, "m 3"],
    height: Float[Tensor, " m"],
    time: Float[Tensor, " m"],
    label: Int64[Tensor, " m"],
    model: MotionModel,
    resolution: float,
    memory: int = 20,
    backwards: bool = False,
) -> State:
    """Where each observation is and how fast it moves, judged by those before it in its cluster.

    A Kalman filter of the motion model over the last ``memory`` observations of the same label and
    the observation itself (:func:`~mixer_torch.tracking.kalman.filter_each`). Nothing
    is known of the velocity before the first: its variance is large.

    Args:
        position: From :func:`box_position`.
        height: Pixels.
        time: Seconds.
        label: Clusters.
        model: How things move.
        resolution: Error of the detector, pixels.
        memory: Earlier observations that are looked at.
        backwards: Judge by those after it instead.
    """
    moment = -time if backwards else time
    before = history(label, moment, memory)
    unit = axis_scale(height)
    speed, jolt = ((unit * unit.new_tensor(x)).square() for x in (model.speed, model.jolt))
    error = measured(height, model, resolution)
    arrays = (before, position, error, time, jolt, FLAT * speed)
    found = filter_each(*(value.detach().cpu().numpy() for value in arrays))
    return State.unpacked(torch.from_numpy(found).to(position.device))


def log_ratio(
    earlier: State,
    later: State,
    seconds: Float[Tensor, " P"],
    height: Float[Tensor, " P"],
    model: MotionModel,
) -> Float[Tensor, "P 3"]:
    """Log likelihood ratio that one path leads through both states, on each axis, nats.

    With x_a and x_b the estimates from what was seen until the earlier and from the later one on,
    both without any prior of the velocity, the ratio of one path against two is

        N(x_b - F x_a; 0, F P_a F' + Q + P_b) / N(v_b; 0, P_b,vv + speed^2),

    x_a having been told that velocities have the standard deviation ``speed``. It is a density on
    the axis, per height (or nat): what is left is to divide by that of strangers.
    """
    unit = axis_scale(height)
    speed, jolt = ((unit * unit.new_tensor(x)).square() for x in (model.speed, model.jolt))
    predicted = earlier.slowed(speed).moved(seconds, jolt)
    dp, dv = (later.mean - predicted.mean).unbind(-1)
    pp, pv, vv = (later.spread + predicted.spread).unbind(-1)
    determinant = pp * vv - pv**2
    squared = (vv * dp**2 - 2 * pv * dp * dv + pp * dv**2) / determinant
    stranger = later.spread[..., 2] + speed
    squared = squared - later.mean[..., 1] ** 2 / stranger
    return -0.5 * (squared + torch.log(determinant / stranger / unit**2) + math.log(2 * math.pi))
