"""What `mixer track` is given: folders and files of detections, each of which is one sequence."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mixer_torch.datasets.base import FrameRange
from mixer_torch.datasets.coco import COCO
from mixer_torch.datasets.motchallenge import MOTChallenge
from mixer_torch.datasets.table import Table
from mixer_torch.io.files import find
from mixer_torch.io.frames import NumberedFrames, plain_frames
from mixer_torch.io.table_tracks import SUFFIXES as TABLES
from mixer_torch.io.tracks import MotTruth, read_mot_truth
from mixer_torch.observations import Observations
from mixer_torch.tracks import Tracks

FRAME_RATE = 30.0
"""Frames per second, by convention, where neither seqinfo.ini nor an option says it."""
TEXT, JSON = (".txt",), (".json",)
OF_FRAMES = ("start", "stop", "step")
"""Options that say which frames to read."""
NEEDED = {"frame": "a column 'frame'", "box": "columns 'x1', 'y1', 'x2' and 'y2'"}


@dataclass(frozen=True)
class Options:
    """How detections are read; as the parameters of :func:`~mixer_torch.commands.track.track`."""

    start: int | None = None
    stop: int | None = None
    step: int = 1
    min_confidence: float | None = None
    pixels: bool | None = None
    frame_rate: float | None = None
    repair: bool = True

    def only(self, *names: str) -> dict[str, Any]:
        """Some of them, as arguments."""
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True)
class Job:
    """One sequence to track.

    Args:
        name: Of the sequence: that of its folder or file.
        observations: The detections, without the truth.
        range: Which frames were read.
        frame_rate: Frames a second.
        notes: Remarks for the user on how it was read.
        last: The last frame of the sequence, if that is known.
        frames: For a video; None for no video.
        files: What was read, and must not be written to.
        truth: The file of the truth, where there is one in MOTChallenge's layout.
    """

    name: str
    observations: Observations
    range: FrameRange
    frame_rate: float
    notes: list[str]
    last: int | None = None
    frames: NumberedFrames | None = None
    files: tuple[Path, ...] = ()
    truth: Path | None = None

    @property
    def numbers(self) -> np.ndarray:
        """The frames that were chosen, those without detections included."""
        frame = self.observations["frame"]
        first = min(int(frame.min()), 1) if len(frame) else 1
        last = max(int(frame.max()) if len(frame) else 0, self.last or 0)
        every = np.arange(first, last + 1)
        return every[self.range.contains(every)]

    def read_truth(self, classes: Sequence[int]) -> tuple[MotTruth, Tracks] | None:
        """The truth, and its part in the frames chosen; None without any.

        Raises:
            ValueError: It is not readable.
        """
        if self.truth is None:
            return None
        truth = read_mot_truth(self.truth, classes)
        return truth, truth.tracks.select(self.range.contains(truth.tracks.frame))


def check_outputs(jobs: Sequence[Job], results: Sequence[Path]) -> None:
    """ValueError where a result would be written over what was read, also through a link."""
    read = {file.resolve() for job in jobs for file in job.files}
    for result in results:
        if result.resolve() in read:
            raise ValueError(f"out: {result} is read, and would be written over; choose another")


def named(sequences: Sequence[Path]) -> dict[str, Path]:
    """Folders and files by the names after which the results are called.

    Raises:
        FileNotFoundError: One is not there.
        ValueError: One is of no kind that can be read, or two have one name.
    """
    found: dict[str, Path] = {}
    for sequence in sequences:
        path = find(sequence)
        if path.is_file() and path.suffix.lower() not in (*TEXT, *JSON, *TABLES):
            known = ", ".join((*TEXT, *JSON, *TABLES))
            raise ValueError(f"sequences: expected a folder, or a file in {known}; got {path}")
        name = _name(path)
        if name in found:
            raise ValueError(
                f"sequences: {found[name]} and {path} are both called {name}, which is the "
                "name of the result; track them one by one, with an --out for each"
            )
        found[name] = path
    return found


def _name(path: Path) -> str:
    """That of the folder; of a file, its own, but det/det.txt is called after its sequence."""
    path = Path(os.path.abspath(path))
    if path.is_dir():
        return path.name
    return path.parent.parent.name if path.parts[-2:] == ("det", "det.txt") else path.stem


def read_job(name: str, path: Path, options: Options, video: bool) -> Job:
    """Read the detections of a sequence.

    Args:
        name: What it is called.
        path: A folder in the layout of MOTChallenge, a text file of such detections, a JSON file in
            the style of COCO, or a table with columns frame, x1, y1, x2 and y2.
        options: How to read it.
        video: Whether frames are wanted for a video.
    """
    if path.suffix.lower() in (*JSON, *TABLES) and path.is_file():
        return _of_file(name, path, options, video)
    notes = []
    given = options.only(*vars(options))
    beside = MOTChallenge(path, frame_rate=1.0)
    if options.frame_rate is None and not (beside.folder / "seqinfo.ini").is_file():
        given["frame_rate"] = FRAME_RATE
        notes.append(
            f"{name}: no seqinfo.ini, so {FRAME_RATE:g} frames per second; see --frame_rate"
        )
    dataset = MOTChallenge(path, truth=False, **given)
    observations, repaired = dataset.read()
    info, truth = dataset.info(), dataset.folder / "gt" / "gt.txt"
    job = Job(
        name, observations, dataset.range, info.frame_rate, notes + repaired, info.length,
        dataset.frames() if video else None, (dataset.detection_file, truth),
        truth if truth.is_file() else None,
    )  # fmt: skip
    size = (info.height, info.width) if info.height and info.width else None
    return _with_frames(job, size) if video else job


def _with_frames(job: Job, size: tuple[int, int] | None) -> Job:
    """A job that has frames for a video, be they plain."""
    if job.frames:
        return job
    frames = plain_frames(job.numbers, job.observations["box"].cpu().numpy(), size)
    if frames:
        note = "no frames, so the video has a plain ground"
    elif len(job.numbers):
        note = "no video, as boxes reach further than any picture does"
    else:
        note = "no video, as there is no frame"
    return replace(job, frames=frames or None, notes=[*job.notes, f"{job.name}: {note}"])


def _of_file(name: str, path: Path, options: Options, video: bool) -> Job:
    """Detections of a JSON file or a table; what they say of identities is not looked at."""
    notes = []
    if path.suffix.lower() in JSON:
        seen = COCO(path, **options.only(*OF_FRAMES, "min_confidence", "pixels")).load()
    else:
        seen = _of_table(path, options)
    rate = options.frame_rate or FRAME_RATE
    features = {key: value for key, value in seen.features.items() if key != "identity"}
    if options.frame_rate is not None or "time" not in features:
        features["time"] = seen["frame"].double() / rate
        if options.frame_rate is None:
            notes.append(f"{name}: {rate:g} frames per second; see --frame_rate")
    hidden = Observations(seen.view, features, seen.images)
    chosen = FrameRange(options.start, options.stop, options.step)
    job = Job(name, hidden, chosen, rate, notes, files=(path,))
    return _with_frames(job, None) if video else job


def _of_table(path: Path, options: Options) -> Observations:
    observations = Table(path, **options.only(*OF_FRAMES)).load()
    for key, columns in NEEDED.items():
        if key not in observations.features:
            raise ValueError(f"{path}: expected {columns}, to track what is in it")
    if options.min_confidence is None:
        return observations
    if "confidence" not in observations.features:
        raise ValueError(f"min_confidence: {path} has no column 'confidence'")
    return observations.select(observations["confidence"] >= options.min_confidence)
