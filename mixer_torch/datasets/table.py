"""One table with a row for each observation: CSV or parquet, for data of your own."""

from __future__ import annotations

import re
import string
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int64

from mixer_torch.datasets.base import (
    Dataset,
    FrameRange,
    check_images,
    check_positive,
    in_space,
    observations_of,
)
from mixer_torch.io.columns import Columns
from mixer_torch.io.files import find
from mixer_torch.observations import FolderFrames, Images, Observations, VideoFrames

BOX = ("x1", "y1", "x2", "y2")
POSITION = ("x", "y", "z")
EMBEDDING = "embedding"
STANDARD = {"view", "frame", "camera", "time", "confidence", "identity", *BOX, *POSITION}


@dataclass(eq=False)
class Table(Dataset):
    """A CSV file with a header (``.tsv``: apart by tabs), or a ``.parquet`` file.

    ============================ ================================================================
    column                       becomes
    ============================ ================================================================
    ``view``                     the view; or else
    ``frame``                    the view, where there is no ``camera`` column; with one, every
                                 pair of camera and frame is a view, numbered in their order
    ``camera``, ``time``         the feature of that name
    ``x1``, ``y1``, ``x2``, ``y2``  ``box``, pixels
    ``x``, ``y`` and maybe ``z`` ``position``, metres; z = 0 if there is none
    ``confidence``               the feature of that name
    ``identity``                 the truth; an empty cell or a negative number is none
    ``embedding_0``, ``_1``, ... ``embedding``; in parquet also one column of lists
    any other with numbers       a float64 feature of its name; a column of text is left out
    ============================ ================================================================

    ``view``, ``camera`` and ``identity`` may hold whole numbers, which stay as they are, or any
    text, which is numbered from 0 in alphabetical order. An empty cell is "not measured": NaN,
    for all coordinates of a box, position or embedding if one is empty; an empty ``view`` is no
    view (-1, distinct from nothing). Observations stay in the order of the rows.

    Args:
        path: The file, as it is or inside ``$MIXER_DATA``.
        start: First frame; from the beginning if None.
        stop: Last frame, included; to the end if None.
        step: From one frame to the next, counting from ``start``, or from 0 if that is None.
        frame_rate: Frames per second, to get time = frame / frame_rate without a ``time`` column.
        images: Where the image of a row is, beside the table: a pattern with columns in braces,
            such as ``frames/{frame:06d}.jpg``, or ``{file}`` for a column of paths.
        video: The video that the frames are from, beside the table, instead of ``images``.
        first_frame: What the table calls the first frame of the video.
    """

    path: str | Path
    start: int | None = None
    stop: int | None = None
    step: int = 1
    frame_rate: float | None = None
    images: str | None = None
    video: str | Path | None = None
    first_frame: int = 0

    def __post_init__(self) -> None:
        self.range = FrameRange(self.start, self.stop, self.step)
        check_positive(frame_rate=self.frame_rate)
        check_images(self.images, self.video)

    def load(self) -> Observations:
        path = find(self.path)
        columns = Columns(path)
        if not columns.columns:
            raise ValueError(f"{path} is empty: expected a header with 'view' or 'frame'")
        view, keep = _views(columns), self._chosen(columns)
        features = {name: value[keep] for name, value in self._features(columns).items()}
        images = self._images(columns, keep, features.get("box"))
        return observations_of(view[keep], features, images)

    def _chosen(self, columns: Columns) -> Int64[np.ndarray, " n"]:
        """The rows of the chosen frames."""
        if self.range.is_all:
            return np.arange(columns.rows)
        return np.flatnonzero(self.range.contains(columns.integers("frame")))

    def _features(self, columns: Columns) -> dict[str, np.ndarray]:
        readers = {"frame": columns.integers, "camera": columns.codes, "time": columns.numbers}
        features = {name: read(name) for name, read in readers.items() if name in columns}
        if "time" not in columns and self.frame_rate is not None:
            features["time"] = columns.integers("frame") / self.frame_rate
        if any(name in columns for name in BOX):
            features["box"] = _boxes(columns)
        if any(name in columns for name in POSITION):
            features["position"] = _positions(columns)
        if "confidence" in columns:
            features["confidence"] = columns.numbers("confidence").astype(np.float32)
        if "identity" in columns:
            features["identity"] = columns.codes("identity", missing=-1).clip(min=-1)
        if any(_is_embedding(name) for name in columns.columns):
            features[EMBEDDING] = _embeddings(columns)
        others = [n for n in columns.columns if n not in STANDARD and not _is_embedding(n)]
        measured = {name: columns.measurement(name) for name in others}
        return features | {name: value for name, value in measured.items() if value is not None}

    def _images(self, columns: Columns, keep: np.ndarray, box: np.ndarray | None) -> Images | None:
        folder = columns.path.parent
        if self.images is not None:
            names = _fill(columns, self.images, keep)
            paths, index = np.unique(names, return_inverse=True)
            return Images(FolderFrames([folder / name for name in paths]), index, box)
        if self.video is None:
            return None
        if "camera" in columns and len(np.unique(columns.codes("camera")[keep])) > 1:
            raise ValueError(f"video: {columns.path} has frames of more than one camera")
        frames = VideoFrames(folder / self.video)
        index = columns.integers("frame") - self.first_frame
        wrong = np.zeros(columns.rows, dtype=bool)
        wrong[keep] = (index[keep] < 0) | (index[keep] >= len(frames))
        last = self.first_frame + len(frames) - 1
        columns.refuse("frame", wrong, f"a frame of the video, {self.first_frame} to {last}")
        return Images(frames, index[keep], box)


def _views(columns: Columns) -> Int64[np.ndarray, " m"]:
    if "view" in columns:
        return columns.codes("view", missing=-1)
    if "frame" not in columns:
        have = ", ".join(columns.columns)
        raise ValueError(f"{columns.path}: column 'view' or 'frame' is missing; columns: {have}")
    frame = columns.integers("frame")
    if "camera" not in columns:
        return frame
    pairs = np.stack([columns.codes("camera"), frame], 1)
    return np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _rows(columns: Columns, names: Sequence[str]) -> Float64[np.ndarray, "m d"]:
    """Columns side by side; a row in which one is missing is missing."""
    rows = np.stack([columns.numbers(name) for name in names], 1)
    rows[np.isnan(rows).any(1)] = np.nan
    return rows


def _boxes(columns: Columns) -> Float32[np.ndarray, "m 4"]:
    box = _rows(columns, BOX)
    columns.refuse("x2", box[:, 2] <= box[:, 0], "more than x1")
    columns.refuse("y2", box[:, 3] <= box[:, 1], "more than y1")
    return box.astype(np.float32)


def _positions(columns: Columns) -> Float32[np.ndarray, "m 3"]:
    position = _rows(columns, POSITION if "z" in columns else POSITION[:2])
    return position.astype(np.float32) if "z" in columns else in_space(position)


def _embeddings(columns: Columns) -> Float32[np.ndarray, "m d"]:
    if EMBEDDING in columns:
        return columns.lists(EMBEDDING).astype(np.float32)
    count = sum(_is_embedding(name) for name in columns.columns)
    return _rows(columns, [f"{EMBEDDING}_{k}" for k in range(count)]).astype(np.float32)


def _is_embedding(name: str) -> bool:
    return re.fullmatch(rf"{EMBEDDING}(_\d+)?", name) is not None


def _fill(columns: Columns, pattern: str, keep: np.ndarray) -> list[str]:
    """A pattern with columns in braces, filled in for each of some rows."""
    names = sorted({name for _, name, _, _ in string.Formatter().parse(pattern) if name})
    cells = {name: columns.words(name) for name in names}
    try:
        return [pattern.format(**{name: cells[name][i] for name in names}) for i in keep]
    except (ValueError, IndexError) as error:
        raise ValueError(f"images: {pattern!r} does not fit the columns: {error}") from error
