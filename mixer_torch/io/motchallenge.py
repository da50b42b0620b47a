"""The files of a MOTChallenge sequence, one by one: what it says of itself, and its tables."""

from __future__ import annotations

import configparser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from mixer_torch.io.frames import usual_suffix
from mixer_torch.io.text import GUESS, read_numbers, refuse, repeated

MIN_COLUMNS = 7
BOX_COLUMNS = 6
"""Columns of a table that ends with the box, and has no scores."""
BOX = slice(2, 6)
"""Columns of the box: left, top, width, height."""
CLASS, CLASS_COLUMNS = 7, 9
UNKNOWN_SCORE = -1.0
"""What the format writes where there is no value."""
LOGIT_LOW, LOGIT_MIDDLE = 1.386, 3.892
"""Log odds of 0.8 and of 0.98."""
SURE = 0.9  # median score of a detector that is sure: Faster R-CNN on MOT15 has 0.96 to 0.99


@dataclass(frozen=True)
class SequenceInfo:
    """What ``seqinfo.ini`` says: frames per second, where frames are stored, how many and how big.

    Args:
        frame_rate: Frames per second.
        image_folder: Folder of frames, inside the sequence's.
        image_suffix: Ending of their names.
        length: How many frames the sequence has; None where that is not said.
        width: Of a frame, pixels; None where that is not said.
        height: Of a frame, pixels; None where that is not said.
    """

    frame_rate: float
    image_folder: str = "img1"
    image_suffix: str = ".jpg"
    length: int | None = None
    width: int | None = None
    height: int | None = None


def read_seqinfo(path: Path, frame_rate: float | None = None) -> SequenceInfo:
    """Read ``seqinfo.ini``.

    Args:
        path: The file.
        frame_rate: Frames per second where the file does not say, or does not exist.

    Raises:
        FileNotFoundError: There is no such file, and no frame rate.
        ValueError: It is not an ini file with a section ``Sequence`` and a positive frameRate.
    """
    if not path.is_file():
        if frame_rate is None:
            raise FileNotFoundError(
                f"{path} does not exist; a MOTChallenge sequence has one: write it, with frameRate "
                "in [Sequence], or set frame_rate"
            )
        return SequenceInfo(frame_rate, image_suffix=usual_suffix(path.parent / "img1"))
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(path.read_text(encoding="utf-8-sig", errors="replace"), source=str(path))
        section = parser["Sequence"]
        if frame_rate is None or "frameRate" in section:
            frame_rate = float(section["frameRate"])
    except configparser.Error as error:
        raise ValueError(f"{path} is not readable as an ini file: {error}") from error
    except KeyError as error:
        raise ValueError(f"{path}: {error} is missing; expected frameRate in [Sequence]") from None
    except ValueError:
        raise ValueError(
            f"{path}: frameRate: expected a number, got {section['frameRate']!r}"
        ) from None
    if not (frame_rate > 0 and np.isfinite(frame_rate)):
        raise ValueError(f"{path}: frameRate: expected a positive number, got {frame_rate}")
    return SequenceInfo(
        frame_rate,
        section.get("imDir", "img1"),
        section.get("imExt", ".jpg"),
        *(_count(path, section, key) for key in ("seqLength", "imWidth", "imHeight")),
    )


def read_table(path: Path) -> tuple[Float64[np.ndarray, "n columns"], Int64[np.ndarray, " n"]]:
    """Read comma-separated lines of frame, id, left, top, width, height, confidence, ...

    Returns:
        The numbers, and the line of the file that each row stands on, from 1. An empty file has
        no rows.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A line is malformed; the message names the file and the line.
    """
    rows, number = read_numbers(path, MIN_COLUMNS, delimiter=",")
    refuse(path, number, ~np.isfinite(rows[:, :MIN_COLUMNS]).all(1), "a number is not finite")
    _check_frames(path, rows, number)
    refuse(path, number, (rows[:, 4:6] <= 0).any(1), "expected a positive width and height")
    return rows, number


def read_truth(
    path: Path, classes: Sequence[int] | None = (1,)
) -> Float64[np.ndarray, "n columns"]:
    """Read the lines of ``gt.txt`` that count: not to be ignored, and of a class to keep; None
    where the columns after the flag are places, whatever they look like.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A line is malformed, or an identity appears twice in a frame.
    """
    rows, number = read_table(path)
    keep = rows[:, 6] != 0
    category = None if classes is None else classes_of(rows)
    if classes is not None and category is not None:
        check_classes(path, category, classes)
        keep &= np.isin(category, classes)
    rows, number = rows[keep], number[keep]
    check_identities(path, number, rows)
    return rows


def classes_of(rows: Float64[np.ndarray, "n columns"]) -> Int64[np.ndarray, " n"] | None:
    """The class of each row, in the eighth column; None where that is no class.

    In nine columns it is one (MOT16 and later: class and visibility), unless all are -1, which is
    "no value". In other numbers of columns it is one where all are whole numbers of 0 or more, not
    all 0, the ninth is a share, and nothing after it is negative (VisDrone has ten: class,
    truncation from 0 to 1, occlusion). MOT15 has places there, x, y and z in metres, or -1.
    """
    if rows.shape[1] <= CLASS or not len(rows):
        return None
    value, share = rows[:, CLASS], rows[:, CLASS + 1 : CLASS + 2]
    if not (np.isfinite(value).all() and (value % 1 == 0).all() and value.any()):
        return None
    if rows.shape[1] == CLASS_COLUMNS:
        told = (value >= 0).any()
    else:
        told = (rows[:, CLASS:] >= 0).all() and (share <= 1).all()
    return value.astype(np.int64) if told else None


def check_classes(
    path: Path, category: Int64[np.ndarray, " n"] | None, classes: Sequence[int]
) -> None:
    """ValueError where rows have classes and none of those wanted: an option that did nothing."""
    if category is not None and not np.isin(category, classes).any():
        there = ", ".join(map(str, np.unique(category).tolist()))
        raise ValueError(f"classes: {path} has none of {list(classes)}; it has {there}")


def check_identities(
    path: Path, number: Int64[np.ndarray, " n"], rows: Float64[np.ndarray, "n columns"]
) -> None:
    """ValueError where an identity is no whole number of 0 or more, or twice in a frame."""
    wrong = (rows[:, 1] < 0) | (rows[:, 1] % 1 != 0)
    expected = "expected an identity of 0 or more; -1 marks a detection of no track"
    refuse(path, number, wrong, expected)
    refuse(path, number, repeated(rows[:, :2]), "this identity is in this frame already")


def read_repaired(
    path: Path, info: SequenceInfo, last: int | None = None
) -> tuple[Float64[np.ndarray, "n columns"], list[str]]:
    """Read detections as detectors and people write them, and say what was not taken.

    Numbers are separated by commas or by white space. Six columns, without a score, will do. Left
    out are boxes with a number that is not finite, with no positive width and height, and wholly
    outside of the image; those of frames after the last one; and of equal boxes in one frame all
    but the one of highest score. What is left does not depend on the order of lines.

    Args:
        path: ``det.txt``.
        info: With the size of the image, where that is known.
        last: The last frame that there is, if known.

    Returns:
        The rows in order of frames, then highest score first, of seven columns or more, and a note
        for each kind of row left out.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A line is no line of numbers, or has no frame; the message names the line.
    """
    rows, number = read_numbers(path, BOX_COLUMNS, GUESS)
    _check_frames(path, rows, number)
    if rows.shape[1] == BOX_COLUMNS:
        rows = np.column_stack([rows, np.full(len(rows), UNKNOWN_SCORE)])
    order = np.lexsort([*rows[:, 5:1:-1].T, -rows[:, 6], rows[:, 0]])
    rows, number = rows[order], number[order]
    notes = []
    for reason, flawed in _flaws(info, last):
        out = flawed(rows)
        if out.any():
            first = number[out].min()
            notes.append(f"{path}: {out.sum():,} left out, {reason}; first in line {first}")
            rows, number = rows[~out], number[~out]
    return rows, notes


def as_confidence(
    score: Float64[np.ndarray, " n"], spread: bool = False
) -> Float64[np.ndarray, " n"]:
    """Scores of one detector as values in [0, 1], in the order of the scores.

    Scores that all are in [0, 1] stay as they are; with ``spread``, only if their median is at
    least 0.9, as that of detectors is that are sure of what they see. Others have a scale of their
    own: those of DPM (the margin of a support vector machine) may be negative, those of ACF (the
    sum of a boosted classifier) or per cent are tens. They become 1 / (1 + exp(-(a + b score)))
    with a and b such that a tenth of them is below 0.8 and half of them below 0.98. So they are
    spread as those of Faster R-CNN are on MOT15, and a threshold means the same. Scores that all
    are one number say nothing (-1 is "no value" in this format): confidence 1.
    """
    if not len(score):
        return score.copy()
    doubtful = spread and np.median(score) < SURE
    if score.min() >= 0 and score.max() <= 1 and not doubtful:
        return score.copy()
    low, middle = np.quantile(score, [0.1, 0.5])
    unit = (middle - low) or (score.max() - score.min())
    if unit == 0:
        return np.ones_like(score)
    logit = LOGIT_LOW + (LOGIT_MIDDLE - LOGIT_LOW) * (score - low) / unit
    return 0.5 + 0.5 * np.tanh(logit / 2)


def _flaws(info: SequenceInfo, last: int | None) -> list[tuple[str, Any]]:
    """Why a row may be left out, and a function of rows in order that says which are."""
    width = np.inf if info.width is None else info.width
    height = np.inf if info.height is None else info.height
    end = np.inf if last is None else last
    return [
        ("a number is not finite", lambda rows: ~np.isfinite(rows[:, :MIN_COLUMNS]).all(1)),
        ("width or height is not positive", lambda rows: (rows[:, 4:6] <= 0).any(1)),
        (
            f"outside of the image of {width:g} x {height:g}",
            lambda rows: (
                (rows[:, 2:4] + rows[:, 4:6] <= 0).any(1)
                | (rows[:, 2] >= width)
                | (rows[:, 3] >= height)
            ),
        ),
        (f"after frame {end:g}, the last by seqinfo.ini", lambda rows: rows[:, 0] > end),
        ("the same box is in this frame already", lambda rows: repeated(rows[:, [0, 2, 3, 4, 5]])),
    ]


def _check_frames(path: Path, rows: np.ndarray, number: np.ndarray) -> None:
    frame = rows[:, 0]
    wrong = ~((frame >= 1) & (frame % 1 == 0))
    refuse(path, number, wrong, "expected a frame of 1 or more")


def _count(path: Path, section: Mapping[str, str], key: str) -> int | None:
    """A whole number of ``seqinfo.ini``; None where it is missing or says that it is not known."""
    text = section.get(key, "").strip()
    try:
        value = float(text or "-1")
    except ValueError:
        raise ValueError(f"{path}: {key}: expected a number, got {text!r}") from None
    return int(value) if value > 0 and np.isfinite(value) else None
