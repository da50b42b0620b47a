"""`mixer track`: from the detections of whole sequences to files of tracks."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from mixer_torch.association import Association
from mixer_torch.commands.associate import device_named
from mixer_torch.commands.jobs import Job, Options, check_outputs, named, read_job
from mixer_torch.commands.own_weights import own_weights
from mixer_torch.commands.text import listing, table
from mixer_torch.io.files import atomic_write, check_folder
from mixer_torch.io.tracks import MotTruth, write_tracks
from mixer_torch.metrics.tracking import evaluate_sequences
from mixer_torch.observations import Observations
from mixer_torch.plots.video import write_track_video
from mixer_torch.scoring import Progress
from mixer_torch.tracking.base import BaseTracker
from mixer_torch.tracking.tracker import Tracker
from mixer_torch.tracks import Tracks

SUFFIX = {"mot": ".txt", "coco": ".json", "csv": ".csv", "parquet": ".parquet"}
METRICS = {"HOTA": "HOTA", "AssA": "AssA", "IDF1": "IDF1", "IDSW": "switches"}
"""The metrics in the table, and the titles of their columns."""


def track(
    sequences: list[Path],
    tracker: BaseTracker | None = None,
    out: Path = Path("out", "tracks"),
    start: int | None = None,
    stop: int | None = None,
    step: int = 1,
    min_confidence: float | None = None,
    classes: list[int] = [1],  # noqa: B006
    pixels: bool | None = None,
    frame_rate: float | None = None,
    repair: bool = True,
    format: Literal["mot", "coco", "csv", "parquet"] = "mot",  # noqa: A002
    video: bool = False,
    train: Path | None = None,
    device: str = "cpu",
    *,
    config: str,
    progress: Progress,
) -> str:
    """Follow objects through whole sequences, and measure the tracks where there is truth.

    A sequence is a folder in the layout of MOTChallenge, of which det/det.txt is enough; or a file:
    text like det.txt, JSON in the style of COCO, or a table (.csv, .tsv, .parquet) with columns
    frame, x1, y1, x2 and y2. The truth, gt/gt.txt, is read for the metrics alone: the tracker does
    not see it, nor identities in a file.

    Args:
        sequences: Folders and files, as they are or inside $MIXER_DATA.
        tracker: The tracker; the default one, Tracker(), where nothing is said.
        out: Folder to write to: SEQUENCE.txt for each, named after its folder, and config.yaml.
        start: First frame; from the beginning if null.
        stop: Last frame, included; to the end if null.
        step: Take every step-th frame.
        min_confidence: Leave out detections whose score is lower.
        classes: Classes to find, for the metrics, where the truth has classes; 1 is pedestrians.
        pixels: Whether the tracker sees images; if null, where every frame with detections has one.
        frame_rate: Frames per second where there is no seqinfo.ini to say it; 30 if null.
        repair: Leave out malformed lines of det.txt, with a note; if false, they are errors.
        format: Of the results: mot (txt, as MOTChallenge has it), coco (json), csv or parquet.
        video: Write SEQUENCE.mp4, too: the frames, or a plain ground where there are none.
        train: Learn weights for a tracker from these sequences and their truth, print what they
            gain on sequences held out, and write them to this .safetensors file; nothing else.
        device: Where to score and solve: cpu, cuda, or cuda:1 and so on.
        config: The resolved configuration, to be written beside the results.
        progress: Called with stage, number done and total while the work goes on.
    """
    sources = named(sequences)
    options = Options(start, stop, step, min_confidence, pixels, frame_rate, repair)
    if train is not None:
        return own_weights(sources, classes, options, train, progress)
    tracker = tracker or Tracker()
    place = device_named(device)
    check_folder(out)
    jobs = [read_job(name, path, options, video) for name, path in sources.items()]
    truths, unreadable = _checked(jobs, format, out, classes)
    out.mkdir(parents=True, exist_ok=True)
    (out / "config.yaml").write_text(config, encoding="utf-8")
    outcomes = _track_all(jobs, tracker.to(place), place, out, SUFFIX[format], progress)
    return _report(jobs, outcomes, truths, unreadable, classes, out)


@dataclass(frozen=True)
class Outcome:
    """The result for one sequence.

    Args:
        tracks: The tracks, after post-processing.
        association: The clusters of detections that they were made from.
        seconds: Time for scoring, solving and post-processing, without reading and writing.
        files: Names of the files that were written.
    """

    tracks: Tracks
    association: Association
    seconds: float
    files: list[str]


def _check_cameras(jobs: Sequence[Job], kind: str) -> None:
    """Several cameras cannot be told apart in the text format: better said before the work."""
    for job in jobs:
        camera = job.observations.features.get("camera")
        if kind == "mot" and camera is not None and len(camera.unique()) > 1:
            raise ValueError(
                f"format: {job.name} is of {len(camera.unique())} cameras, which mot cannot tell "
                "apart; choose --format coco, csv or parquet"
            )


def _checked(
    jobs: Sequence[Job], kind: str, out: Path, classes: Sequence[int]
) -> tuple[dict[str, tuple[MotTruth, Tracks]], list[str]]:
    """The truth of each sequence that has one, and its part in the frames chosen; and notes."""
    _check_cameras(jobs, kind)
    check_outputs(jobs, [out / f"{job.name}{SUFFIX[kind]}" for job in jobs])
    truths, notes = {}, []
    for job in jobs:
        try:
            truth = job.read_truth(classes)
        except ValueError as error:
            notes.append(f"{job.name}: no metrics, as the truth is not readable: {error}")
            continue
        if truth is not None:
            truths[job.name] = truth
    return truths, notes


def _track_all(
    jobs: Sequence[Job],
    tracker: BaseTracker,
    place: torch.device,
    out: Path,
    suffix: str,
    progress: Progress,
) -> dict[str, Outcome]:
    """Track one sequence after the other. On an interrupt, say which ones are finished."""
    outcomes: dict[str, Outcome] = {}
    try:
        for job in jobs:
            result = out / f"{job.name}{suffix}"
            outcomes[job.name] = _track(job, tracker, place, result, progress)
    except KeyboardInterrupt:
        finished = ", ".join(outcomes) or "none"
        raise KeyboardInterrupt(f"finished, and in {out}: {finished}") from None
    return outcomes


def _track(
    job: Job, tracker: BaseTracker, place: torch.device, result: Path, progress: Progress
) -> Outcome:
    """Track one sequence and write its result, each file whole or not at all."""

    def told(what: str, done: int, of: int) -> None:
        progress(f"{job.name}: {what}", done, of)

    begin = time.perf_counter()
    observations = job.observations.to(place)
    try:
        with torch.no_grad():
            association = tracker.associate(observations, told)
            tracks = tracker.finish(observations, association)
    except (ValueError, KeyError) as error:
        raise ValueError(f"{job.name}: {error.args[0] if error.args else error}") from error
    seconds = time.perf_counter() - begin
    write_tracks(result, tracks)
    files = [result.name]
    if job.frames:
        files.append(f"{job.name}.mp4")
        _write_video(result.with_name(files[-1]), job, tracks, told)
    return Outcome(tracks, association, seconds, files)


def _write_video(path: Path, job: Job, tracks: Tracks, progress: Progress) -> None:
    with atomic_write(path) as partial:
        write_track_video(partial, tracks, job.frames, job.frame_rate, progress)  # type: ignore[arg-type]


def _report(
    jobs: Sequence[Job],
    outcomes: Mapping[str, Outcome],
    truths: Mapping[str, tuple[MotTruth, Tracks]],
    notes: Sequence[str],
    classes: Sequence[int],
    out: Path,
) -> str:
    """The table of all sequences, notes, and the files that were written."""
    metrics = _measure(jobs, outcomes, truths, classes)
    notes = [
        *(note for job in jobs for note in job.notes),
        *notes,
        *_findings(jobs, outcomes),
        *_latencies(outcomes),
    ]
    written = ["config.yaml", *(name for one in outcomes.values() for name in one.files)]
    return "\n".join(
        [
            _table(jobs, outcomes, metrics),
            "",
            *(f"note: {note}" for note in notes),
            *listing(out, written),
        ]
    )


def _measure(
    jobs: Sequence[Job],
    outcomes: Mapping[str, Outcome],
    truths: Mapping[str, tuple[MotTruth, Tracks]],
    classes: Sequence[int],
) -> dict[str, Mapping[str, Any]]:
    """The metrics of each sequence that has truth and, as "", of these together."""
    if not truths:
        return {}
    seen = {job.name: job.observations for job in jobs}
    results = {
        name: truth.without_distractors(_of_classes(outcomes[name].tracks, seen[name], classes))
        for name, (truth, _) in truths.items()
    }
    found = evaluate_sequences(results, {name: chosen for name, (_, chosen) in truths.items()})
    return {**found["sequences"], "": found["combined"]}


def _of_classes(tracks: Tracks, seen: Observations, classes: Sequence[int]) -> Tracks:
    """Tracks of the classes that are to be found, where detections have classes."""
    if "category" not in seen.features or not len(tracks):
        return tracks
    observed = tracks.observation >= 0
    category = seen["category"].cpu().numpy()[tracks.observation[observed]]
    wanted = np.unique(tracks.identity[observed][np.isin(category, classes)])
    return tracks.select(np.isin(tracks.identity, wanted))


def _findings(jobs: Sequence[Job], outcomes: Mapping[str, Outcome]) -> list[str]:
    """What was measured on each sequence, or that there was nothing to track."""
    notes = []
    for job in jobs:
        if not len(job.observations):
            notes.append(f"{job.name}: no detections, so no tracks")
            continue
        measured = outcomes[job.name].association.stats.get("measured", {})
        notes += [f"{job.name}: {one.summary}" for one in measured.values()]
    return notes


def _latencies(outcomes: Mapping[str, Outcome]) -> list[str]:
    """Time from a frame to its answer, for trackers that work online."""
    notes = []
    for name, outcome in outcomes.items():
        seconds = outcome.association.stats.get("latency", ())
        if len(seconds):
            half, most, worst = 1000 * np.quantile(seconds, [0.5, 0.99, 1])
            notes.append(
                f"{name}: {half:.1f} ms a frame (median), {most:.1f} ms for 99 of 100, "
                f"{worst:.1f} ms at worst"
            )
    return notes


def _table(
    jobs: Sequence[Job], outcomes: Mapping[str, Outcome], metrics: Mapping[str, Mapping[str, Any]]
) -> str:
    """One line for each sequence, and one for all where there are several."""
    titles = ["sequence", "frames", "detections", "tracks", "seconds", "frames/s"]
    titles += [*(METRICS.values() if metrics else ()), "status"]
    rows, sums = [], np.zeros(4)
    for job in jobs:
        outcome = outcomes[job.name]
        found = len(np.unique(outcome.tracks.identity))
        counts = np.array([len(job.numbers), len(job.observations), found, outcome.seconds])
        sums += counts
        cells = [*_cells(counts), *_measured(metrics, job.name)]
        rows.append([job.name, *cells, outcome.association.status.value])
    if len(jobs) > 1:
        rows.append(["all", *_cells(sums), *_measured(metrics, ""), ""])
    return table(rows, titles, last=True)


def _cells(counts: np.ndarray) -> list[str]:
    """The numbers of frames, detections and tracks, seconds, and frames per second."""
    *numbers, seconds = counts
    rate = counts[0] / max(seconds, 1e-9)
    return [*(f"{number:,.0f}" for number in numbers), f"{seconds:.1f}", f"{rate:,.1f}"]


def _measured(metrics: Mapping[str, Mapping[str, Any]], name: str) -> list[str]:
    """The cells of the metrics of one sequence, dashes where it has no truth."""
    if not metrics:
        return []
    values = [metrics.get(name, {}).get(key) for key in METRICS]
    return [
        "-" if value is None else f"{value:,d}" if isinstance(value, int) else f"{value:.1f}"
        for value in values
    ]
