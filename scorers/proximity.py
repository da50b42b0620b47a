"""Proximity of positions."""

from __future__ import annotations

import torch
from torch import Tensor

from mixer_torch.scoring import Calibrator, Scorer


class Proximity(Scorer):
    """Same place, same object: a Gaussian of the distance, fading to 0.5 as time passes.

    Odometry drifts and objects move, so distance says less the longer ago the other sighting was.
    With distance d and time dt between two sightings the score is

        0.5 + (exp(-e^2 / 2 scale^2) - 0.5) * exp(-dt / memory),    e = max(0, d - speed * dt),

    where e is the distance beyond what an object can cover in the time in between. At speed 0 it
    is 0.5 at the distance 1.18 scale; and it is 0.5 everywhere once dt is several times the memory.

    Args:
        scale: Standard deviation of a measured distance, in the unit of the feature (metres for
            ``position``).
        memory: Time after which position has lost all but 1/e of its say, seconds; ``inf`` where
            nothing drifts or moves.
        speed: How fast an object can move, metres a second: 0 for objects that stay where they
            are, 1.5 for people who walk.
        feature: Where it was: ``position``, or any other of a fixed number of coordinates.
        calibrator: Maps that score to another.

    Raises:
        ValueError: scale or memory is not positive, or speed is negative.
    """

    def __init__(
        self,
        scale: float = 1.0,
        memory: float = 10.0,
        speed: float = 0.0,
        feature: str = "position",
        calibrator: Calibrator | None = None,
    ) -> None:
        super().__init__(calibrator)
        if not (0 < scale < float("inf") and memory > 0):
            raise ValueError(f"scale, memory: expected positive numbers, got {scale}, {memory}")
        if not 0 <= speed < float("inf"):
            raise ValueError(f"speed: expected a finite number >= 0, got {speed}")
        self.scale = scale
        self.memory = memory
        self.speed = speed
        self.needs = (feature, "time")

    def compare(self, description: tuple[Tensor, Tensor], pairs: Tensor) -> Tensor:
        position, time = description
        a, b = pairs
        position = position if position.is_floating_point() else position.float()
        squared = (position[a] - position[b]).flatten(1).square().sum(1)
        elapsed = (time[a] - time[b]).abs().to(squared)
        if self.speed > 0:
            reach = self.speed * elapsed
            within = squared <= reach.square()
            # Inside the reach there is no gradient to have, and the root has none at 0.
            distance = squared.where(~within, torch.ones_like(squared)).sqrt()
            squared = (distance - reach).square().where(~within, torch.zeros_like(squared))
        near = torch.exp(-squared / (2 * self.scale**2))
        return 0.5 + (near - 0.5) * torch.exp(-elapsed / self.memory)
