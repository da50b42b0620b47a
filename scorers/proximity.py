"""Proximity of positions."""

from __future__ import annotations

import torch
from torch import Tensor

from mixer_torch.scoring import Calibrator, Scorer


class Proximity(Scorer):
    """Same place, same object: a Gaussian of the distance, fading to 0.5 as time passes.

    Odometry drifts and objects move, so distance says less the longer ago the other sighting was.
    With distance d and time dt between two sightings the score is

        0.5 + (exp(-d^2 / 2 sigma^2) - 0.5) * exp(-dt / memory),   sigma = scale + speed * dt,

    which is 0.5 at the distance 1.18 sigma, and everywhere once dt is several times the memory.

    Args:
        scale: Standard deviation of the distance between two sightings of one object at one time,
            in the unit of the feature (metres for ``position``).
        memory: Time after which position has lost all but 1/e of its say, seconds; ``inf`` where
            nothing drifts or moves.
        speed: How fast ``scale`` grows with the time in between, metres a second: 0 for objects
            that stay where they are, about 1 for people who walk.
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
        sigma = self.scale + self.speed * elapsed
        near = torch.exp(-squared / (2 * sigma.square()))
        return 0.5 + (near - 0.5) * torch.exp(-elapsed / self.memory)
