"""Tracks as text in the format of MOTChallenge: results in and out, and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from mixer_torch.boxes import assign, corners, iou, left_top_size
from mixer_torch.io.files import atomic_write
from mixer_torch.io.motchallenge import (
    BOX,
    BOX_COLUMNS,
    check_classes,
    check_identities,
    classes_of,
    read_table,
)
from mixer_torch.io.text import GUESS, read_numbers, refuse
from mixer_torch.tracks import Tracks, from_one

CONFIDENCE = 6
UNKNOWN = -1
DISTRACTORS = (2, 7, 8, 12)
"""Persons on vehicles, static persons, distractors and reflections, by their class."""
VEHICLE = 6
"""A vehicle without motor, which is a distractor in MOT20 alone."""
DISTRACTOR_OVERLAP = 0.5


def read_mot(path: str | Path) -> Tracks:
    """Read results: lines of frame, id, left, top, width, height, and more that may be missing.

    The seventh column is the confidence; -1 says that it is not known. All columns after it are
    let by. What stands between numbers is commas, or white space where the first line has no
    comma. Whole numbers may be written as 3.0. Where identities count from 0, all are raised by 1.

    Args:
        path: Text file; one of no lines has no tracks.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A line is malformed, a frame or an identity is no whole number of 0 or more (an
            identity of -1 is a detection of no track), or an identity is twice in a frame; the
            message names the file and the line.
    """
    path = Path(path)
    rows, number = read_numbers(path, BOX_COLUMNS, GUESS)
    refuse(path, number, ~np.isfinite(rows[:, :BOX_COLUMNS]).all(1), "a number is not finite")
    refuse(path, number, (rows[:, 0] < 0) | (rows[:, 0] % 1 != 0), "expected a frame of 0 or more")
    check_identities(path, number, rows)
    confidence = rows[:, CONFIDENCE] if rows.shape[1] > CONFIDENCE else np.ones(len(rows))
    confidence = np.where(confidence == UNKNOWN, np.nan, confidence)
    return _tracks(rows, confidence)


def write_mot(path: str | Path, tracks: Tracks) -> None:
    """Write results: frame, id, left, top, width, height, confidence, -1, -1, -1.

    Pixels have two decimals, and a confidence that is not known is -1.

    Raises:
        ValueError: The tracks are of several cameras, which the format cannot tell apart.
    """
    tracks.check_one_camera()
    sure = np.where(np.isnan(tracks.confidence), UNKNOWN, tracks.confidence)
    rows = zip(
        tracks.frame.tolist(),
        tracks.identity.tolist(),
        left_top_size(tracks.box).tolist(),
        sure.tolist(),
        strict=True,
    )
    with atomic_write(path) as partial, partial.open("w", encoding="utf-8", newline="\n") as file:
        for frame, identity, (left, top, width, height), confidence in rows:
            box = f"{left:.2f},{top:.2f},{width:.2f},{height:.2f}"
            file.write(f"{frame},{identity},{box},{confidence:.4g},-1,-1,-1\n")


@dataclass(frozen=True, eq=False)
class MotTruth:
    """The truth of a sequence: what is to be found, and what is neither right nor wrong to find.

    Args:
        tracks: What is to be found.
        frame: (k,) int64 of the boxes that are not to be found: marked to be ignored (flag 0), or
            of another class.
        box: (k, 4) float64 x1 y1 x2 y2 of these.
        distractor: (k,) bool, those that may be found.
    """

    tracks: Tracks
    frame: Any
    box: Any
    distractor: Any

    def without_distractors(self, result: Tracks) -> Tracks:
        """The boxes that count, as MOTChallenge has them.

        In each frame the boxes of a result are assigned to all true boxes, of whatever class and
        flag, so that the sum of overlaps is greatest; from 0.5 upwards an overlap counts. Those
        assigned to a distractor are left out. Those on other boxes that are not to be found stay,
        and are wrong.
        """
        away = np.zeros(len(result), dtype=bool)
        order = np.argsort(self.frame, kind="stable")
        others = self.frame[order]
        for frame in np.unique(self.frame[self.distractor]).tolist():
            found = _rows_of(frame, result.frame)
            other = order[_rows_of(frame, others)]
            wanted = self.tracks.box[_rows_of(frame, self.tracks.frame)]
            true = np.concatenate([wanted, self.box[other]])
            distractor = np.append(np.zeros(len(wanted), dtype=bool), self.distractor[other])
            row, column = assign(iou(true, result.box[found]), DISTRACTOR_OVERLAP)
            away[found][column[distractor[row]]] = True
        return result.select(~away)


def read_mot_truth(
    path: str | Path, classes: Sequence[int] = (1,), distractors: Sequence[int] | None = None
) -> MotTruth:
    """Read ``gt.txt``: frame, id, left, top, width, height, flag, ...

    Rows of flag 0 are not to be found. Where the eighth column is a class
    (:func:`~mixer_torch.io.motchallenge.classes_of`) those of other classes are not, either; where
    it is none, there is one class and no distractors.

    Args:
        path: The file.
        classes: What is to be found, by class; 1 is pedestrians.
        distractors: What may be found, by class; if None, persons on vehicles (2), static persons
            (7), distractors (8) and reflections (12), and in sequences whose folder is called
            MOT20... vehicles without motor (6), too.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A line is malformed, an identity is twice in a frame, or no row is of a class
            to be found; the message names the file and the line.
    """
    path = Path(path)
    if distractors is None:
        of_mot20 = path.resolve().parent.parent.name.startswith("MOT20")
        distractors = (*DISTRACTORS, VEHICLE) if of_mot20 else DISTRACTORS
    rows, number = read_table(path)
    wanted = rows[:, 6] != 0
    distractor = np.zeros(len(rows), dtype=bool)
    category = classes_of(rows)
    check_classes(path, category, classes)
    if category is not None:
        wanted &= np.isin(category, classes)
        distractor = np.isin(category, distractors)
    check_identities(path, number[wanted], rows[wanted])
    frame, box = rows[~wanted, 0].astype(np.int64), corners(rows[~wanted, BOX])
    return MotTruth(_tracks(rows[wanted]), frame, box, distractor[~wanted])


def _tracks(rows: Float64[np.ndarray, "n columns"], confidence: Any = None) -> Tracks:
    frame, identity = rows[:, :2].astype(np.int64).T
    return Tracks(frame, from_one(identity), corners(rows[:, BOX]), confidence)


def _rows_of(frame: int, frames: Int64[np.ndarray, " n"]) -> slice:
    """Where a frame stands among frames in order."""
    return slice(*np.searchsorted(frames, [frame, frame + 1]))
