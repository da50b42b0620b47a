"""Labelled sequences to learn from: as they are, made harder, and simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64, Int64

from mixer_torch.datasets.simulated import Simulated
from mixer_torch.observations import Observations
from mixer_torch.tracking.following import DETECTION, described
from mixer_torch.tracking.measured import Measured, Sequence, measure

UNKNOWN = -2
"""Identity of a detection that counts neither as an object nor as clutter."""
LONGEST_RUN = 40
"""Frames for which an object may be missing in what is made harder."""


@dataclass(frozen=True)
class Example:
    """A labelled sequence, measured and described.

    Args:
        sequence: The detections.
        measured: What was measured of it.
        description: (n, 8) features of detections by themselves.
        identity: (n,) the truth: -1 clutter, :data:`UNKNOWN` what does not count.
        frame_rate: Frames a second.
    """

    sequence: Sequence
    measured: Measured
    description: Float64[np.ndarray, "n d"]
    identity: Int64[np.ndarray, " n"]
    frame_rate: float


def examples(
    observations: Observations, seed: int = 0, variants: int = 2, rows: int = 2000
) -> list[Example]:
    """Measured and described stretches of a labelled sequence: one as it is, others made harder.

    The others have every second or third frame only, noisier boxes, and detections that are
    missing, some of them many frames in a row: a tracker meets all frame rates and detectors.

    Args:
        observations: With ``frame``, ``time``, ``box``, ``confidence`` where there is one, and
            ``identity``: -1 for clutter, :data:`UNKNOWN` for what does not count.
        seed: Of the draws.
        variants: How many.
        rows: Detections of each, about.

    Raises:
        KeyError: A feature is missing.
    """
    rng = np.random.default_rng(seed)
    table = _table(observations)
    span = table.time[-1] - table.time[0] if len(table.frame) else 0.0
    rate = (table.frame[-1] - table.frame[0]) / span if span > 0 else 1.0
    found = []
    for k in range(variants):
        stride = int(rng.integers(1, 4)) if k else 1
        part = table.stretch(rows * stride, rng)
        if k:
            part = part.every(stride).noisy(_sometimes(rng, 0.06), rng)
            part = part.gappy(_sometimes(rng, 0.4), rng)
        if len(part.frame):
            found.append(example(part, rate / stride))
    return found


def example(table: Table, frame_rate: float) -> Example:
    """Measure and describe labelled detections."""
    sequence = Sequence.of(table.frame, table.corners, table.score)
    measured = measure(sequence)
    description = describe(sequence, measured)
    return Example(sequence, measured, description, table.identity, frame_rate)


def _sometimes(rng: np.random.Generator, most: float) -> float:
    """0 in half of the cases, else up to ``most``."""
    return float(rng.uniform(0, most)) if rng.random() < 0.5 else 0.0


@dataclass(frozen=True)
class Table:
    """Labelled detections in order of frames; all (n,) but ``corners``, (n, 4) x1 y1 x2 y2."""

    frame: np.ndarray
    time: np.ndarray
    corners: np.ndarray
    score: np.ndarray
    identity: np.ndarray

    def select(self, keep: np.ndarray) -> Table:
        """Some of the rows."""
        return Table(*(value[keep] for value in vars(self).values()))

    def stretch(self, rows: int, rng: np.random.Generator) -> Table:
        """A run of frames with about so many rows."""
        n = len(self.frame)
        if n <= rows:
            return self
        first = self.frame[rng.integers(0, n - rows + 1)]
        last = self.frame[min(int(np.searchsorted(self.frame, first)) + rows, n - 1)]
        return self.select((self.frame >= first) & (self.frame <= last))

    def every(self, stride: int) -> Table:
        """Every ``stride``-th frame, numbered one after the other."""
        kept = self.select((self.frame - self.frame[0]) % stride == 0)
        return replace(kept, frame=(kept.frame - kept.frame[0]) // stride)

    def noisy(self, jitter: float, rng: np.random.Generator) -> Table:
        """Edges of boxes moved by noise of a standard deviation of so many sizes."""
        side = self.corners[:, 2:] - self.corners[:, :2]
        size = np.sqrt(side.prod(1))[:, None]
        noise = np.clip(jitter * rng.normal(size=self.corners.shape), -0.2, 0.2)
        return replace(self, corners=self.corners + noise * np.minimum(size, side.min(1)[:, None]))

    def gappy(self, share: float, rng: np.random.Generator) -> Table:
        """Without a share of the rows: half of them at random, half in runs along identities."""
        keep = rng.random(len(self.frame)) >= share / 2
        order = np.lexsort((self.frame, self.identity))
        begins = rng.random(len(order)) < share / 2 / LONGEST_RUN * 2
        length = rng.integers(1, LONGEST_RUN, len(order))
        covered = np.zeros(len(order) + LONGEST_RUN, dtype=int)
        np.add.at(covered, np.flatnonzero(begins), 1)
        np.add.at(covered, np.flatnonzero(begins) + length[begins], -1)
        keep[order[np.cumsum(covered)[: len(order)] > 0]] = False
        return self.select(keep | (share == 0))


def _table(observations: Observations) -> Table:
    frame = observations["frame"].cpu().numpy()
    order = np.argsort(frame, kind="stable")
    score = observations.features.get("confidence", torch.ones(len(frame)))
    columns = (frame, observations["time"], observations["box"], score, observations["identity"])
    arrays = [np.asarray(column)[order] for column in columns]
    return Table(*(a if a.dtype.kind == "i" else a.astype(np.float64) for a in arrays))


def simulated(count: int, seed: int = 0, rows: int = 1500) -> list[Example]:
    """Stretches of simulated sequences, each of a scene of its own."""
    found = []
    for k in range(count):
        seen = Simulated(seed=seed + k).load()
        if len(seen):
            found += examples(seen, seed + k, variants=1, rows=rows)
    return found


def describe(sequence: Sequence, measured: Measured) -> Float64[np.ndarray, "n d"]:
    """Features of all detections by themselves."""
    parts = [
        described(sequence.box[rows], sequence.score[rows], measured)
        for rows in map(sequence.rows, range(len(sequence.frames)))
    ]
    return np.concatenate(parts) if parts else np.zeros((0, len(DETECTION)))
