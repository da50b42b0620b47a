"""Points tracked by hand over a sequence of images, in the layout of the CMU hotel."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mixer_torch.datasets.base import Dataset, FrameRange, check_positive, observations_of
from mixer_torch.io.files import find
from mixer_torch.io.text import read_numbers
from mixer_torch.observations import FolderFrames, Images, Observations


@dataclass(eq=False)
class Landmarks(Dataset):
    """One file of points for each image: row r of every file is the same physical point.

    A file has a line "x y" in pixels for each point; "nan nan" where a point is not seen, which
    then is no observation. Files and images are both put in order of the last number in their
    names, and the k-th of one belongs to the k-th of the other: in the CMU hotel,
    ``landmarks/hotel1.txt`` and ``images/hotel.seq0.png``.

    Features: ``frame``, from 0 in that order, which is the view as well; ``time``, frame /
    frame_rate; ``camera``, 0; ``point`` (m, 2) float32 x y in pixels; ``box``, the square about
    the point; ``confidence``, 1; ``identity``, the row.

    Args:
        path: The folder, as it is or inside ``$MIXER_DATA``.
        start: First frame.
        stop: Last frame, included; to the end if None.
        step: From one frame to the next.
        box_size: Side of the box about each point, pixels.
        frame_rate: Frames per second.
        images: Whether to attach the pixels.
        points_pattern: Where the files of points are, as a glob inside the folder.
        images_pattern: Where the images are.
    """

    path: str | Path
    start: int = 0
    stop: int | None = None
    step: int = 10
    box_size: float = 48.0
    frame_rate: float = 1.0
    images: bool = True
    points_pattern: str = "landmarks/*.txt"
    images_pattern: str = "images/*.png"

    def __post_init__(self) -> None:
        if self.start < 0:
            raise ValueError(f"start: expected 0 or more, got {self.start}")
        self.range = FrameRange(self.start, self.stop, self.step)
        check_positive(box_size=self.box_size, frame_rate=self.frame_rate)

    def load(self) -> Observations:
        folder = find(self.path)
        files = in_order(folder, self.points_pattern)
        chosen = np.flatnonzero(self.range.contains(np.arange(len(files))))
        frame, row, point = _stack({k: _read_points(files[k]) for k in chosen.tolist()})
        half = self.box_size / 2
        features = {
            "frame": frame,
            "time": frame / self.frame_rate,
            "camera": np.zeros_like(frame),
            "point": point.astype(np.float32),
            "box": np.concatenate([point - half, point + half], 1).astype(np.float32),
            "confidence": np.ones(len(frame), dtype=np.float32),
            "identity": row,
        }
        images = None
        if self.images:
            paths = in_order(folder, self.images_pattern)
            if len(paths) != len(files):
                raise ValueError(
                    f"{folder}: expected one image for each of {len(files)} files "
                    f"{self.points_pattern}, got {len(paths)} {self.images_pattern}"
                )
            images = Images(FolderFrames(paths), frame, features["box"])
        return observations_of(frame, features, images)


def in_order(folder: Path, pattern: str) -> list[Path]:
    """The files that match, in order of the last number in their names.

    Raises:
        FileNotFoundError: There are none.
        ValueError: A name has no number.
    """
    numbered = []
    for file in folder.glob(pattern):
        digits = re.findall(r"\d+", file.stem)
        if not digits:
            raise ValueError(f"{file}: expected a number in the name, to put the files in order")
        numbered.append((int(digits[-1]), file.name, file))
    if not numbered:
        raise FileNotFoundError(f"{folder}: no file matches {pattern}")
    return [file for *_, file in sorted(numbered)]


def _read_points(path: Path) -> np.ndarray:
    points, _ = read_numbers(path, columns=2)
    if points.shape[1] != 2:
        raise ValueError(f"{path}: expected 2 numbers a line, x y, got {points.shape[1]}")
    return points


def _stack(points: dict[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frame, row and point of every landmark that is seen."""
    frame = [np.full(len(rows), k, dtype=np.int64) for k, rows in points.items()]
    row = [np.arange(len(rows)) for rows in points.values()]
    empty = np.empty(0, dtype=np.int64)
    stacked = np.concatenate([np.empty((0, 2)), *points.values()])
    seen = np.isfinite(stacked).all(1)
    return np.concatenate([empty, *frame])[seen], np.concatenate([empty, *row])[seen], stacked[seen]
