"""Crops of persons, a folder for each, from several cameras: re-identification."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mixer_torch.datasets.balance import BalancedFrames
from mixer_torch.datasets.base import Dataset, observations_of
from mixer_torch.io.files import find
from mixer_torch.observations import FolderFrames, Images, Observations

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png")


@dataclass(eq=False)
class Persons(Dataset):
    """One image an observation: ``<person>/<camera>_<orientation>.png``.

    All three are numbers, as in ``007/02_5.png``; images may be png, jpg or bmp. An image is no
    part of a view (-1): any two may show the same person. Order: person, camera, orientation.

    Features: ``identity``, the person; ``camera``; ``orientation``; ``box``, the whole image.

    Args:
        path: The folder, as it is or inside ``$MIXER_DATA``.
        cameras: Cameras to read; all if None.
        orientations: Orientations to read; all if None.
        limit: How many persons to read, the first in order; all if None.
        skip: How many persons to pass over before that, the first in order.
        balance: Whether to take off the colour cast of the cameras, by mapping the brightness of
            each channel to common ground (:mod:`mixer_torch.datasets.balance`): for cameras that
            saw the same persons on the whole. Only what is read counts.

    Raises:
        ValueError: limit or skip is negative.
    """

    path: str | Path
    cameras: Sequence[int] | None = None
    orientations: Sequence[int] | None = None
    limit: int | None = None
    skip: int = 0
    balance: bool = False

    def __post_init__(self) -> None:
        if (self.limit is not None and self.limit < 0) or self.skip < 0:
            raise ValueError(f"limit, skip: expected 0 or more, got {self.limit} and {self.skip}")

    def load(self) -> Observations:
        folder = find(self.path)
        found = sorted(
            (*_numbers(file), file)
            for file in folder.glob("*/*")
            if file.suffix.lower() in SUFFIXES
        )
        if not found:
            raise FileNotFoundError(f"{folder}: no image is in <person>/<camera>_<orientation>.png")
        persons = sorted({person for person, *_ in found})[self.skip :][: self.limit]
        chosen = [
            row
            for row in found
            if row[0] in persons
            and (self.cameras is None or row[1] in self.cameras)
            and (self.orientations is None or row[2] in self.orientations)
        ]
        numbers = np.array([row[:3] for row in chosen], dtype=np.int64).reshape(-1, 3)
        frames: Sequence[Any] = FolderFrames([file for *_, file in chosen])
        sizes = [frame.shape[1::-1] for frame in frames]
        if self.balance:
            frames = BalancedFrames(frames, numbers[:, 1])
        box = np.zeros((len(chosen), 4), dtype=np.float32)
        box[:, 2:] = np.array(sizes).reshape(-1, 2)
        names = ("identity", "camera", "orientation")
        features = {name: numbers[:, k].copy() for k, name in enumerate(names)}
        images = Images(frames, np.arange(len(chosen)), box)
        return observations_of(np.full(len(chosen), -1), features | {"box": box}, images)


def _numbers(file: Path) -> tuple[int, int, int]:
    """Person, camera and orientation."""
    match = re.fullmatch(r"(\d+)/(\d+)_(\d+)", f"{file.parent.name}/{file.stem}")
    if match is None:
        raise ValueError(f"{file}: expected a name like 007/02_5.png, person/camera_orientation")
    person, camera, orientation = map(int, match.groups())
    return person, camera, orientation
