"""Through all frames of a sequence: with the whole of it measured, or with what was seen so far."""

from __future__ import annotations

import time
from collections.abc import Sequence as Listed
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from mixer_torch.scoring import Progress
from mixer_torch.tracking.camera_steps import AT_REST
from mixer_torch.tracking.following import (
    DETECTION,
    Follower,
    described,
    frame_of,
    odds_of_objects,
)
from mixer_torch.tracking.measured import Measured, Sequence, measure
from mixer_torch.tracking.objects import Boxes, numbered
from mixer_torch.tracking.running import Running


def follow_whole(
    sequence: Sequence,
    camera: Float64[np.ndarray, "T 3"] | None,
    follower: Follower,
    progress: Progress | None = None,
) -> tuple[Boxes, Measured]:
    """Measure the whole sequence, then follow it.

    Args:
        sequence: The detections.
        camera: The camera's steps where they are known.
        follower: Puts detections on tracks.
        progress: Called with stage, number done and total.
    """
    measured = measure(sequence, camera)
    n = len(sequence.box)
    label, link = np.full(n, -1), np.zeros(n)
    parts = []
    for t in range(len(sequence.frames)):
        rows = sequence.rows(t)
        parts.append(_by_themselves(sequence, rows, follower, measured))
        frame = frame_of(sequence, t, *parts[-1])
        label[rows], link[rows] = follower.step(t, frame, measured.camera[t], measured)
        if progress is not None:
            progress("frames", t + 1, len(sequence.frames))
    meaning, rank = measured.means(sequence.score), measured.rank(sequence.score)
    return _boxes(sequence, numbered(label), link, parts, meaning, rank), measured


def follow_online(
    sequence: Sequence,
    camera: Float64[np.ndarray, "T 3"] | None,
    follower: Follower,
    latency: list[float],
    progress: Progress | None = None,
) -> tuple[Boxes, Measured]:
    """Follow each frame by what was measured up to it.

    Args:
        sequence: The detections.
        camera: The camera's steps where they are known.
        follower: Puts detections on tracks.
        latency: The time that each frame took is added to it, seconds.
        progress: Called with stage, number done and total.
    """
    running = Running(sequence.unit)
    n = len(sequence.box)
    label, link, meaning, rank = np.full(n, -1), np.zeros(n), np.zeros(n), np.zeros(n)
    path = np.tile(AT_REST, (max(len(sequence.frames), 1), 1))
    parts = []
    for t in range(len(sequence.frames)):
        begin = time.perf_counter()
        rows = sequence.rows(t)
        score = sequence.score[rows]
        known = None if camera is None else camera[t]
        path[t] = running.add(sequence.box[rows], score, sequence.category[rows], known)
        measured = running.measured
        parts.append(_by_themselves(sequence, rows, follower, measured))
        frame = frame_of(sequence, t, *parts[-1])
        label[rows], link[rows] = follower.step(t, frame, path[t], measured)
        meaning[rows], rank[rows] = measured.means(score), measured.rank(score)
        latency.append(time.perf_counter() - begin)
        if progress is not None:
            progress("frames", t + 1, len(sequence.frames))
    measured = replace(running.measured, camera=path)
    return _boxes(sequence, numbered(label), link, parts, meaning, rank), measured


def _by_themselves(
    sequence: Sequence, rows: slice, follower: Follower, measured: Measured
) -> tuple[np.ndarray, np.ndarray]:
    """Odds of being objects, and the description, of the detections of one frame."""
    description = described(sequence.box[rows], sequence.score[rows], measured)
    return odds_of_objects(follower.weights["objectness"], description), description


def _boxes(
    sequence: Sequence,
    label: np.ndarray,
    link: np.ndarray,
    parts: Listed[tuple[np.ndarray, np.ndarray]],
    meaning: np.ndarray,
    rank: np.ndarray,
) -> Boxes:
    """What is known of each detection, from its frames."""
    odds = np.concatenate([np.zeros(0), *(part for part, _ in parts)])
    description = np.concatenate([np.zeros((0, len(DETECTION))), *(part for _, part in parts)])
    overlap, most, neighbours = (
        description[:, DETECTION.index(name)]
        for name in ("overlap_stronger", "overlap", "neighbours")
    )
    return Boxes(label, sequence.frame, odds, overlap, link, rank, meaning, most, neighbours)
