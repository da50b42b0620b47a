"""What a dataset is: a place that observations come from."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64

from mixer_torch.observations import Images, Observations

SOURCES = ("det", "gt")
"""Observe detections, or the true boxes."""


class Dataset(ABC):
    """A format. Its constructor takes a local path and what to read; :meth:`load` reads it."""

    @abstractmethod
    def load(self) -> Observations:
        """Read the observations; pixels stay on disk until they are asked for.

        Raises:
            FileNotFoundError: A file or folder is missing; the message names it.
            ValueError: A file is malformed; the message names the file and the line.
        """


@dataclass(frozen=True)
class FrameRange:
    """Which frames of a sequence are read.

    Args:
        start: First frame; from the beginning if None.
        stop: Last frame, included; to the end if None.
        step: From one frame to the next, counting from ``start``, or from 0 if that is None.

    Raises:
        ValueError: step is less than 1.
    """

    start: int | None = None
    stop: int | None = None
    step: int = 1

    def __post_init__(self) -> None:
        if self.step < 1:
            raise ValueError(f"step: expected 1 or more, got {self.step}")

    @property
    def is_all(self) -> bool:
        """Whether no frame is left out."""
        return self == FrameRange()

    def contains(self, frame: Any) -> Bool[np.ndarray, " n"]:
        """Which of some frame numbers (n,) are read."""
        keep = (frame - (self.start or 0)) % self.step == 0
        if self.start is not None:
            keep &= frame >= self.start
        return keep if self.stop is None else keep & (frame <= self.stop)


def observations_of(
    view: np.ndarray, features: Mapping[str, np.ndarray], images: Images | None = None
) -> Observations:
    """Observations from arrays."""
    tensors = {name: torch.from_numpy(value) for name, value in features.items()}
    return Observations(torch.from_numpy(view), tensors, images)


def in_space(point: Float64[np.ndarray, "m 2"]) -> np.ndarray:
    """Points of the ground with z = 0, as float32; a row of NaN stays one."""
    height = np.where(np.isnan(point[:, :1]), np.nan, 0)
    return np.concatenate([point, height], 1).astype(np.float32)


def check_source(source: str) -> None:
    """ValueError unless it is one of :data:`SOURCES`."""
    if source not in SOURCES:
        raise ValueError(f"source: expected 'det' or 'gt', got {source!r}")


def check_positive(**values: float | None) -> None:
    """ValueError that names the first that is neither positive and finite nor None."""
    for name, value in values.items():
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise ValueError(f"{name}: expected a positive number, got {value}")


def check_not_negative(**values: float) -> None:
    """ValueError that names the first that is negative or not finite."""
    for name, value in values.items():
        if not (value >= 0 and math.isfinite(value)):
            raise ValueError(f"{name}: expected a finite number >= 0, got {value}")


def check_images(images: str | None, video: Any) -> None:
    """ValueError where there are both images and a video."""
    if images is not None and video is not None:
        raise ValueError(f"images, video: expected one of them, got {images!r} and {video!r}")
