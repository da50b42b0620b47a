"""Sequences in the layout of MOTChallenge: detections, truth, frames and calibration."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mixer_torch.boxes import check_min_overlap, corners, foot_points, true_identities
from mixer_torch.datasets.base import (
    Dataset,
    FrameRange,
    check_not_negative,
    check_positive,
    check_source,
    in_space,
    observations_of,
)
from mixer_torch.datasets.calibration import find_calibration, read_calibration
from mixer_torch.datasets.local_motion import local_motion
from mixer_torch.io.files import find
from mixer_torch.io.frames import NumberedFrames, find_frames
from mixer_torch.io.motchallenge import (
    BOX,
    SequenceInfo,
    as_confidence,
    classes_of,
    read_repaired,
    read_seqinfo,
    read_table,
    read_truth,
)
from mixer_torch.observations import Images, Observations


@dataclass(eq=False)
class MOTChallenge(Dataset):
    """One sequence: a folder with ``seqinfo.ini``, ``det/det.txt`` and what else there is.

    A text file will do as well: the detections, in the place of ``det/det.txt`` of the folder that
    it is in, or of the one above if that is called ``det``.

    Lines of ``det.txt`` are frame, id, left, top, width, height, confidence, ...; of
    ``gt/gt.txt`` the same with a flag in the seventh place, 0 for regions to ignore, which are
    dropped. The eighth column may be a class
    (:func:`~mixer_torch.io.motchallenge.classes_of`). Each frame is one view, numbered as in the
    table. Lines may be in any order.

    Features: ``frame``; ``time``, (frame - 1) / frameRate; ``camera``, 0; ``box``;
    ``confidence``, the score as a value in [0, 1]
    (:func:`~mixer_torch.io.motchallenge.as_confidence`; it is one already for most
    detectors, and not for DPM and ACF); ``category`` where there are classes; ``identity`` where
    there is truth: that of the true box which the detection is assigned to, -1 for clutter;
    ``position`` where there is a calibration: the ground point under the middle of the box's lower
    edge, z = 0, in the frame of the calibration. Boxes are as in the table, which counts pixels
    from 1.

    Frames are read from ``img1/000001.jpg``, ... (folder and ending as in ``seqinfo.ini``), or
    from the one file in ``video/``, whose k-th frame, from 1, is frame k. A calibration is a Tsai
    camera, ``calib/*.xml``, or ``homography.txt``, 3x3 from pixels to ground metres. Where there
    is none but truth has ground positions (``gt/gt.txt`` of MOT15), ``calibration`` can name that.

    Args:
        path: The folder, or the text file, as it is or inside ``$MIXER_DATA``.
        start: First frame; from the beginning if None.
        stop: Last frame, included; to the end if None.
        step: From one frame to the next.
        source: Observe the detections, or the true boxes.
        min_confidence: Leave out detections whose score, as it is in the file, is under this.
        min_overlap: Intersection over union from which a detection is a true box's.
        classes: Classes to keep of truth that has a class column; 1 is pedestrians.
        pixels: Whether to attach images; if None, where every frame with observations has one.
        calibration: Calibration file, as it is or inside ``$MIXER_DATA``
            (:func:`~mixer_torch.datasets.calibration.read_calibration`); if None, the one in the
            folder, if there is one.
        frame_rate: Frames per second where there is no ``seqinfo.ini`` to say it.
        truth: Whether to read ``gt/gt.txt`` for identities, where it is there.
        repair: Take what can be used of a detection file that is not quite right (see
            :func:`~mixer_torch.io.motchallenge.read_repaired`), with a warning for
            each kind of line that is left out; if False, such a line is an error. Frames after
            the ``seqLength`` of ``seqinfo.ini`` are left out, unless ``stop`` says otherwise.
        spread: Also spread the scores of a detector that is seldom sure, so that thresholds of
            confidence mean the same for all detectors.
        window: Half-width, seconds, of the stretch of video over which position and ``velocity``
            (metres a second, NaN where it cannot be told) are fitted, from the boxes of all
            frames, chosen or not, earlier or later
            (:func:`~mixer_torch.datasets.local_motion.local_motion`); 0 for positions as they were
            measured. It needs a calibration.

    Raises:
        ValueError: A number is out of range, or source is none of the two.
        FileNotFoundError: When it loads: there is no such sequence, or no calibration and a window.
    """

    path: str | Path
    start: int | None = None
    stop: int | None = None
    step: int = 1
    source: Literal["det", "gt"] = "det"
    min_confidence: float | None = None
    min_overlap: float = 0.5
    classes: Sequence[int] = (1,)
    pixels: bool | None = None
    calibration: str | Path | None = None
    frame_rate: float | None = None
    truth: bool = True
    repair: bool = False
    spread: bool = False
    window: float = 0.0

    def __post_init__(self) -> None:
        # The format counts frames from 1.
        self.range = FrameRange(1 if self.start is None else self.start, self.stop, self.step)
        check_source(self.source)
        check_min_overlap(self.min_overlap)
        check_positive(frame_rate=self.frame_rate)
        check_not_negative(window=self.window)

    def load(self) -> Observations:
        observations, notes = self.read()
        for note in notes:
            warnings.warn(note, stacklevel=2)
        return observations

    def read(self) -> tuple[Observations, list[str]]:
        """The observations, and what ``repair`` has left out, instead of warnings."""
        folder, info = self.folder, self.info()
        table, chosen, identity, notes = self._rows(folder, info)
        rows = table[chosen]
        frame, box = rows[:, 0].astype(np.int64), corners(rows[:, BOX])
        features = {
            "frame": frame,
            "time": (frame - 1) / info.frame_rate,
            "camera": np.zeros_like(frame),
            "box": box.astype(np.float32),
            "confidence": rows[:, 6].astype(np.float32),
        }
        category = classes_of(table)
        if category is not None:
            features["category"] = category[chosen]
        if identity is not None:
            features["identity"] = identity
        features |= self._places(folder, info, table, chosen)
        return observations_of(frame, features, self._images(folder, info, frame, box)), notes

    @property
    def folder(self) -> Path:
        """Where the sequence is.

        Raises:
            FileNotFoundError: It is nowhere.
        """
        path = find(self.path)
        if path.is_dir():
            return path
        return path.parent.parent if path.parent.name == "det" else path.parent

    @property
    def detection_file(self) -> Path:
        """Where its detections are."""
        path = find(self.path)
        return path / "det" / "det.txt" if path.is_dir() else path

    def info(self) -> SequenceInfo:
        """What ``seqinfo.ini`` says."""
        return read_seqinfo(self.folder / "seqinfo.ini", self.frame_rate)

    def frames(self) -> NumberedFrames | None:
        """All chosen frames that have pixels, with observations or not; None without any."""
        info = self.info()
        sources = find_frames(self.folder, info.image_folder, info.image_suffix, self.chosen)
        return max(sources, key=len, default=None)

    def _rows(
        self, folder: Path, info: SequenceInfo
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, list[str]]:
        """All lines, which of them to observe in order of frames, their identities, and notes."""
        file = folder / "gt" / "gt.txt"
        truth = None
        if self.source == "gt" or (self.truth and file.is_file()):
            truth = read_truth(file, self.classes)
        if self.source == "gt" and truth is not None:
            truth[:, 6] = 1
            chosen = self._choose(truth)
            return truth, chosen, truth[chosen, 1].astype(np.int64), []
        table, notes = self._detections(self.detection_file, info)
        chosen = self._choose(table)
        if truth is None:
            return table, chosen, None, notes
        rows, truth = table[chosen], truth[self._choose(truth)]
        identity = true_identities(
            rows[:, 0],
            corners(rows[:, BOX]),
            truth[:, 0],
            corners(truth[:, BOX]),
            truth[:, 1],
            self.min_overlap,
        )
        return table, chosen, identity, notes

    def _detections(self, file: Path, info: SequenceInfo) -> tuple[np.ndarray, list[str]]:
        """The lines of ``det.txt``, with their confidence in the place of the score, and notes."""
        if self.repair:
            rows, notes = read_repaired(file, info, info.length if self.stop is None else None)
        else:
            rows, notes = read_table(file)[0], []
        score = rows[:, 6].copy()
        rows[:, 6] = as_confidence(score, self.spread)
        if self.min_confidence is not None:
            rows = rows[score >= self.min_confidence]
        return rows, notes

    def _choose(self, rows: np.ndarray) -> np.ndarray:
        """Which lines are of the chosen frames, in order of frames."""
        chosen = np.flatnonzero(self.chosen(rows[:, 0]))
        return chosen[np.argsort(rows[chosen, 0], kind="stable")]

    def chosen(self, frame: np.ndarray) -> np.ndarray:
        """Which of these frames are to be read, by ``start``, ``stop`` and ``step``."""
        return self.range.contains(frame)

    def _places(
        self, folder: Path, info: SequenceInfo, table: np.ndarray, chosen: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Position of the chosen lines, and velocity where there is a window."""
        ground = (
            find_calibration(folder)
            if self.calibration is None
            else read_calibration(find(self.calibration))
        )
        if ground is None:
            if self.window:
                raise FileNotFoundError(
                    f"{folder}: no calibration, which window needs, got window {self.window}"
                )
            return {}
        if not self.window:
            return {
                "position": in_space(ground.to_ground(foot_points(corners(table[chosen, BOX]))))
            }
        box = corners(table[:, BOX])
        place, velocity = local_motion(
            table[:, 0].astype(np.int64),
            box,
            ground.to_ground(foot_points(box)),
            chosen,
            info.frame_rate,
            self.window,
        )
        return {"position": in_space(place), "velocity": in_space(velocity)}

    def _images(
        self, folder: Path, info: SequenceInfo, frame: np.ndarray, box: np.ndarray
    ) -> Images | None:
        """Pixels from the folder of frames, else from the video, as ``pixels`` wants them."""
        if self.pixels is False:
            return None
        missing = None
        for source in find_frames(folder, info.image_folder, info.image_suffix, self.chosen):
            if (place := source.places(frame)) is not None:
                return Images(source.frames, place, box)
            missing = frame[~np.isin(frame, source.number)] if missing is None else missing
        if self.pixels:
            first = (frame if missing is None else missing)[:1]
            image = "".join(f"{number:06d}{info.image_suffix}" for number in first)
            raise FileNotFoundError(
                f"frame {folder / info.image_folder / image} does not exist; "
                "choose frames that have an image, or set pixels to null or false"
            )
        return None
