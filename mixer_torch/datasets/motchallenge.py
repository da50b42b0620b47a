"""Sequences in the layout of MOTChallenge: detections, truth, frames and calibration."""

from __future__ import annotations

import configparser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64, Int64
from scipy.optimize import linear_sum_assignment

from mixer_torch.datasets.base import Dataset, find
from mixer_torch.datasets.calibration import find_calibration, read_calibration
from mixer_torch.datasets.text import read_numbers, refuse
from mixer_torch.observations import FolderFrames, Images, Observations, VideoFrames

MIN_COLUMNS = 7
CLASS_COLUMNS = 9
VIDEO_SUFFIXES = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".webm")


class MOTChallenge(Dataset):
    """One sequence: a folder with ``seqinfo.ini``, ``det/det.txt`` and what else there is.

    Lines of ``det.txt`` are frame, id, left, top, width, height, confidence, ...; of
    ``gt/gt.txt`` the same with a flag in the seventh place, 0 for regions to ignore, which are
    dropped. Truth of nine columns is that of MOT16 and later, with a class in the eighth. Each
    frame is one view, numbered as in the table.

    Features: ``frame``; ``time``, (frame - 1) / frameRate; ``camera``, 0; ``box``;
    ``confidence``; ``identity`` where there is truth: that of the true box which the detection
    is assigned to, -1 for clutter; ``position`` where there is a calibration: the ground point
    under the middle of the box's lower edge, z = 0, in the frame of the calibration. Boxes are
    as in the table, which counts pixels from 1.

    Frames are read from ``img1/000001.jpg``, ... (folder and ending as in ``seqinfo.ini``), or
    from the one file in ``video/``, whose k-th frame, from 1, is frame k. A calibration is a Tsai
    camera, ``calib/*.xml``, or ``homography.txt``, 3x3 from pixels to ground metres.

    Args:
        path: The folder, as it is or inside ``$MIXER_DATA``.
        start: First frame; from the beginning if None.
        stop: Last frame, included; to the end if None.
        step: From one frame to the next.
        source: Observe the detections, or the true boxes.
        min_confidence: Leave out detections under this.
        min_overlap: Intersection over union from which a detection is a true box's.
        classes: Classes to keep of truth that has a class column; 1 is pedestrians.
        pixels: Whether to attach images; if None, where every frame with observations has one.
        calibration: Calibration file; if None, the one in the folder, if there is one.
    """

    def __init__(
        self,
        path: str | Path,
        start: int | None = None,
        stop: int | None = None,
        step: int = 1,
        source: Literal["det", "gt"] = "det",
        min_confidence: float | None = None,
        min_overlap: float = 0.5,
        classes: Sequence[int] = (1,),
        pixels: bool | None = None,
        calibration: str | Path | None = None,
    ) -> None:
        if step < 1:
            raise ValueError(f"step: expected 1 or more, got {step}")
        if source not in ("det", "gt"):
            raise ValueError(f"source: expected 'det' or 'gt', got {source!r}")
        if not 0 < min_overlap <= 1:
            raise ValueError(f"min_overlap: expected a value in (0, 1], got {min_overlap}")
        self.path = Path(path)
        self.start, self.stop, self.step = start, stop, step
        self.source = source
        self.min_confidence = min_confidence
        self.min_overlap = min_overlap
        self.classes = tuple(classes)
        self.pixels = pixels
        self.calibration = calibration

    def load(self) -> Observations:
        folder = find(self.path)
        info = read_seqinfo(folder / "seqinfo.ini")
        rows, identity = self._rows(folder)
        frame, box = rows[:, 0].astype(np.int64), corners(rows)
        features = {
            "frame": frame,
            "time": (frame - 1) / info.frame_rate,
            "camera": np.zeros_like(frame),
            "box": box.astype(np.float32),
            "confidence": rows[:, 6].astype(np.float32),
        }
        if identity is not None:
            features["identity"] = identity
        if (position := self._position(folder, box)) is not None:
            features["position"] = position
        return Observations(
            torch.from_numpy(frame),
            {name: torch.from_numpy(value) for name, value in features.items()},
            self._images(folder, info, frame, box),
        )

    def _rows(self, folder: Path) -> tuple[np.ndarray, np.ndarray | None]:
        """The lines to observe, in order of frames, and the identity of each."""
        file = folder / "gt" / "gt.txt"
        truth = None
        if self.source == "gt" or file.is_file():
            truth = self._choose(read_truth(file, self.classes))
        if self.source == "gt" and truth is not None:
            truth[:, 6] = 1
            return truth, truth[:, 1].astype(np.int64)
        rows = self._choose(read_table(folder / "det" / "det.txt")[0])
        if self.min_confidence is not None:
            rows = rows[rows[:, 6] >= self.min_confidence]
        if truth is None:
            return rows, None
        identity = np.full(len(rows), -1, dtype=np.int64)
        mine, theirs = match_boxes(
            rows[:, 0], corners(rows), truth[:, 0], corners(truth), self.min_overlap
        )
        identity[mine] = truth[theirs, 1]
        return rows, identity

    def _choose(self, rows: np.ndarray) -> np.ndarray:
        """The lines of the chosen frames, in order of frames."""
        frame = rows[:, 0]
        start = 1 if self.start is None else self.start
        keep = (frame >= start) & ((frame - start) % self.step == 0)
        if self.stop is not None:
            keep &= frame <= self.stop
        rows = rows[keep]
        return rows[np.argsort(rows[:, 0], kind="stable")]

    def _position(self, folder: Path, box: np.ndarray) -> np.ndarray | None:
        ground = (
            find_calibration(folder)
            if self.calibration is None
            else read_calibration(find(self.calibration))
        )
        if ground is None:
            return None
        point = ground.to_ground(foot_points(box))
        height = np.where(np.isnan(point[:, :1]), np.nan, 0)
        return np.concatenate([point, height], 1).astype(np.float32)

    def _images(
        self, folder: Path, info: SequenceInfo, frame: np.ndarray, box: np.ndarray
    ) -> Images | None:
        """Pixels from the folder of frames, else from the video, as ``pixels`` wants them."""
        if self.pixels is False:
            return None
        chosen, index = np.unique(frame, return_inverse=True)
        paths = [folder / info.image_folder / f"{k:06d}{info.image_suffix}" for k in chosen]
        missing = next((path for path in paths if not path.is_file()), None)
        if missing is None and (paths or (folder / info.image_folder).is_dir()):
            return Images(FolderFrames(paths), index, box)
        if (video := find_video(folder)) is not None:
            frames = VideoFrames(video)
            if not len(frame) or frame.max() <= len(frames):
                return Images(frames, frame - 1, box)
            missing = missing or video
        if self.pixels:
            raise FileNotFoundError(
                f"frame {missing or folder / info.image_folder} does not exist; "
                "choose frames that have an image, or set pixels to null or false"
            )
        return None


@dataclass(frozen=True)
class SequenceInfo:
    """What ``seqinfo.ini`` says: frames per second, and where and how frames are stored."""

    frame_rate: float
    image_folder: str = "img1"
    image_suffix: str = ".jpg"


def read_seqinfo(path: Path) -> SequenceInfo:
    """Read ``seqinfo.ini``.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is not an ini file with a section ``Sequence`` and a positive frameRate.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; a MOTChallenge sequence has one")
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(path.read_text(encoding="utf-8"), source=str(path))
        section = parser["Sequence"]
        rate = float(section["frameRate"])
    except configparser.Error as error:
        raise ValueError(f"{path} is not readable as an ini file: {error}") from error
    except KeyError as error:
        raise ValueError(f"{path}: {error} is missing; expected frameRate in [Sequence]") from None
    except ValueError:
        raise ValueError(
            f"{path}: frameRate: expected a number, got {section['frameRate']!r}"
        ) from None
    if not (rate > 0 and np.isfinite(rate)):
        raise ValueError(f"{path}: frameRate: expected a positive number, got {rate}")
    return SequenceInfo(rate, section.get("imDir", "img1"), section.get("imExt", ".jpg"))


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
    frame = rows[:, 0]
    refuse(path, number, (frame < 1) | (frame % 1 != 0), "expected a frame of 1 or more")
    refuse(path, number, (rows[:, 4:6] <= 0).any(1), "expected a positive width and height")
    return rows, number


def read_truth(path: Path, classes: Sequence[int] = (1,)) -> Float64[np.ndarray, "n columns"]:
    """Read the lines of ``gt.txt`` that count: not to be ignored, and of a class to keep.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A line is malformed, or an identity appears twice in a frame.
    """
    rows, number = read_table(path)
    keep = rows[:, 6] != 0
    if rows.shape[1] == CLASS_COLUMNS:
        keep &= np.isin(rows[:, 7], classes)
    rows, number = rows[keep], number[keep]
    identity = rows[:, 1]
    refuse(path, number, (identity < 0) | (identity % 1 != 0), "expected an identity of 0 or more")
    first = np.unique(rows[:, :2], axis=0, return_index=True)[1]
    repeated = np.ones(len(rows), dtype=bool)
    repeated[first] = False
    refuse(path, number, repeated, "this identity is in this frame already")
    return rows


def match_boxes(
    frame_a: Float64[np.ndarray, " a"],
    box_a: Float64[np.ndarray, "a 4"],
    frame_b: Float64[np.ndarray, " b"],
    box_b: Float64[np.ndarray, "b 4"],
    min_overlap: float = 0.5,
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Frame by frame, the one-to-one assignment of boxes of greatest total overlap.

    Maximise the sum of intersection over union over assigned pairs, subject to one-to-one and to
    a pair counting only from ``min_overlap`` upwards.

    Returns:
        Indices in a and indices in b of the pairs that count.
    """
    pairs = []
    for frame in np.intersect1d(frame_a, frame_b):
        a, b = np.flatnonzero(frame_a == frame), np.flatnonzero(frame_b == frame)
        overlap = box_overlap(box_a[a], box_b[b])
        overlap[overlap < min_overlap] = 0
        row, column = linear_sum_assignment(overlap, maximize=True)
        counts = overlap[row, column] > 0
        pairs.append((a[row[counts]], b[column[counts]]))
    if not pairs:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    return np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])


def box_overlap(
    a: Float64[np.ndarray, "a 4"], b: Float64[np.ndarray, "b 4"]
) -> Float64[np.ndarray, "a b"]:
    """Intersection over union of each box x1 y1 x2 y2 of a with each of b."""
    low = np.maximum(a[:, None, :2], b[:, :2])
    high = np.minimum(a[:, None, 2:], b[:, 2:])
    intersection = (high - low).clip(min=0).prod(-1)
    area_a, area_b = ((box[:, 2:] - box[:, :2]).prod(-1) for box in (a, b))
    return intersection / (area_a[:, None] + area_b - intersection)


def corners(rows: Float64[np.ndarray, "n columns"]) -> Float64[np.ndarray, "n 4"]:
    """Boxes x1 y1 x2 y2 from left, top, width, height in columns 2 to 5."""
    return np.concatenate([rows[:, 2:4], rows[:, 2:4] + rows[:, 4:6]], 1)


def foot_points(box: Float64[np.ndarray, "n 4"]) -> Float64[np.ndarray, "n 2"]:
    """Where each box meets the ground: the middle of its lower edge."""
    return np.column_stack([(box[:, 0] + box[:, 2]) / 2, box[:, 3]])


def find_video(folder: Path) -> Path | None:
    """The file in ``video/``, None without one.

    Raises:
        ValueError: There is more than one.
    """
    files = sorted(
        file for file in (folder / "video").glob("*") if file.suffix.lower() in VIDEO_SUFFIXES
    )
    if len(files) > 1:
        raise ValueError(f"{folder}: expected one video, got {[file.name for file in files]}")
    return files[0] if files else None
