"""Proximity of positions."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.scoring import Calibrator, Scorer


class Proximity(Scorer):
    """Same place, same object: a Gaussian of the distance, fading to 0.5 as time passes.

    Odometry drifts and objects move, so distance says less the longer ago the other sighting was.
    With distance d and time dt between two sightings the score is

        0.5 + (exp(-e^2 / 2 scale^2) - 0.5) * exp(-dt / memory),    e = max(0, d - speed * dt),

    where e is the distance beyond what an object can cover in the time in between. At speed 0 it
    is 0.5 at the distance 1.18 scale; and it is 0.5 everywhere once dt is several times the memory.

    With ``swerve``, objects are expected to keep their velocity v (feature ``velocity``): d is the
    distance between where both would be halfway in time, and the reach is no longer speed * dt but

        (speed + swerve * (|v_a| + |v_b|) / 2) * dt,

    so that the reach of what moves fast is larger. Where one velocity is not known, the other takes
    its place; where neither is, only sightings at one time are compared.

    Args:
        scale: Standard deviation of a measured distance, in the unit of the feature (metres for
            ``position``).
        memory: Time after which evidence has faded to 1/e, seconds; ``inf`` where nothing drifts or
            moves.
        speed: How fast an object can move, metres a second: 0 for objects that stay where they
            are, 1.5 for people who walk.
        feature: Where it was: ``position``, or any other of a fixed number of coordinates.
        swerve: Error of a predicted velocity as a share of the speed; None to ignore velocities.
        calibrator: Maps that score to another.

    Raises:
        ValueError: scale or memory is not positive, or speed or swerve is negative.
        KeyError: With swerve, when it scores: the observations have no velocity.
    """

    def __init__(
        self,
        scale: float = 1.0,
        memory: float = 10.0,
        speed: float = 0.0,
        feature: str = "position",
        swerve: float | None = None,
        calibrator: Calibrator | None = None,
    ) -> None:
        super().__init__(calibrator)
        if not (0 < scale < float("inf") and memory > 0):
            raise ValueError(f"scale, memory: expected positive numbers, got {scale}, {memory}")
        if not 0 <= speed < float("inf"):
            raise ValueError(f"speed: expected a finite number >= 0, got {speed}")
        if swerve is not None and not 0 <= swerve < float("inf"):
            raise ValueError(f"swerve: expected a finite number >= 0 or None, got {swerve}")
        self.scale = scale
        self.memory = memory
        self.speed = speed
        self.swerve = swerve
        self.needs = (feature, "time")

    def describe(self, observations: Observations) -> tuple[Tensor, ...]:
        """Positions, times, and velocities with swerve: those may be missing, so are not needs."""
        described = tuple(observations[key] for key in self.needs)
        return described if self.swerve is None else (*described, observations["velocity"])

    def compare(self, description: tuple[Tensor, ...], pairs: Tensor) -> Tensor:
        position, time, *velocity = description
        a, b = pairs
        position = position if position.is_floating_point() else position.float()
        apart = (position[b] - position[a]).flatten(1)
        elapsed = (time[b] - time[a]).to(apart)
        speed: float | Tensor = self.speed
        if self.swerve is not None:
            shift, mean = _motion(velocity[0].to(apart), elapsed, pairs)
            apart, speed = apart - shift, speed + self.swerve * mean
        squared, elapsed = apart.square().sum(1), elapsed.abs()
        if self.speed > 0 or self.swerve is not None:
            reach = speed * elapsed
            within = squared <= reach.square()
            # Within reach the gradient is 0: the root is of 1 there, as it has no gradient at 0.
            distance = squared.where(~within, torch.ones_like(squared)).sqrt()
            squared = (distance - reach).square().where(~within, torch.zeros_like(squared))
        near = torch.exp(-squared / (2 * self.scale**2))
        return 0.5 + (near - 0.5) * torch.exp(-elapsed / self.memory)


def _motion(
    velocity: Float[Tensor, "m d"], elapsed: Float[Tensor, " P"], pairs: Int64[Tensor, "2 P"]
) -> tuple[Float[Tensor, "P d"], Float[Tensor, " P"]]:
    """Displacement by the mean velocity of a pair, and the mean of their speeds.

    Both are 0 for pairs at one time of which no velocity is known.
    """
    a, b = velocity[pairs[0]], velocity[pairs[1]]
    a, b = a.where(a.isfinite(), b), b.where(b.isfinite(), a)
    moved = (elapsed != 0) | a.isfinite().all(1)
    a, b = (v.where(moved[:, None], torch.zeros_like(v)) for v in (a, b))
    return (a + b) / 2 * elapsed[:, None], (a.norm(dim=1) + b.norm(dim=1)) / 2
