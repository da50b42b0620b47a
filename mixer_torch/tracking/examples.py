"""Labelled sequences to learn from: as they are, made harder, and simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64, Int64
from scipy.stats import rankdata

from mixer_torch.datasets.simulated import Simulated
from mixer_torch.observations import Observations
from mixer_torch.tracking.following import DETECTION, described
from mixer_torch.tracking.measured import Measured, Sequence, measure

UNKNOWN = -2
"""Identity of a detection that counts neither as an object nor as clutter."""
LONGEST_RUN = 40
"""Frames for which an object may be missing in what is made harder."""
LONGEST_LIFE = 8
"""Mean frames, at most, for which clutter that is added goes along with a thing."""


@dataclass(frozen=True)
class Example:
    """A labelled sequence, measured and described.

    Args:
        sequence: The detections.
        measured: What was measured of it.
        description: (n, d) features of detections by themselves.
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

    The others have every second or third frame only, noisier boxes, more clutter, and detections
    that are missing, some of them many frames in a row: a tracker meets all frame rates and
    detectors.

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
    if not len(table.frame):
        return []
    span = table.time[-1] - table.time[0]
    rate = (table.frame[-1] - table.frame[0]) / span if span > 0 else 1.0
    found = []
    for k in range(variants):
        stride = int(rng.integers(1, 4)) if k else 1
        part = table.stretch(rows * stride, rng)
        if k:
            part = part.every(stride).noisy(_sometimes(rng, 0.06), rng)
            part = part.cluttered(_sometimes(rng, 2.0), rng).gappy(_sometimes(rng, 0.4), rng)
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

    def cluttered(self, share: float, rng: np.random.Generator) -> Table:
        """With false detections, so many as that share of the rows, as detectors with a long tail
        of low scores have them: parts of a thing, or places beside it, that go along with it for a
        while. Scores become places in the order of scores; those of clutter are mostly lower.
        """
        n = len(self.frame)
        if not share or not n:
            return self
        life = rng.uniform(1, LONGEST_LIFE)
        begin = rng.integers(0, n, rng.poisson(share * n / life))
        length = rng.geometric(1 / life, len(begin))
        run = np.repeat(np.arange(len(begin)), length)
        place = begin[run] + np.arange(len(run)) - np.repeat(np.cumsum(length) - length, length)
        order = np.lexsort((self.frame, self.identity))
        same = place < n
        same[same] = self.identity[order[place[same]]] == self.identity[order[begin[run[same]]]]
        run, host = run[same], order[place[same]]
        side = self.corners[host, 2:] - self.corners[host, :2]
        on_it = rng.random(len(begin)) < 0.5
        away = rng.normal(size=(len(begin), 2)) * np.where(on_it, 0.15, 1.5)[:, None]
        scale = rng.uniform(0.4, 1.2, (len(begin), 2))
        away, scale = (value[run] + 0.03 * rng.normal(size=side.shape) for value in (away, scale))
        middle = self.corners[host, :2] + side * (0.5 + away)
        box = np.concatenate([middle - side * scale / 2, middle + side * scale / 2], 1)
        rank = rankdata(self.score) / n
        level = rng.normal(rng.uniform(-0.6, 0.2), 0.25, len(begin))
        low = level[run] + 0.1 * rng.normal(size=len(run))
        both = (self.frame, self.time, self.corners, rank, self.identity)
        false = (self.frame[host], self.time[host], box, low, np.full(len(host), -1))
        together = Table(*(np.concatenate(pair) for pair in zip(both, false, strict=True)))
        return together.select(np.argsort(together.frame, kind="stable"))

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
