"""The boxes of tracks beside those of the truth: who is there when, and who overlaps whom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.optimize import linear_sum_assignment

from mixer_torch.boxes import iou
from mixer_torch.tracks import Tracks


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes in order of steps; a step is a frame of a camera in which there is any box.

    Args:
        step: (n,) int64 from 0, ascending.
        identity: (n,) int64 from 0.
        count: (identities,) int64 boxes of each identity.
        start: (steps + 1,) int64, where each step starts.
    """

    step: Int64[np.ndarray, " n"]
    identity: Int64[np.ndarray, " n"]
    count: Int64[np.ndarray, " identities"]
    start: Int64[np.ndarray, " bounds"]


@dataclass(frozen=True, eq=False)
class Overlaps:
    """All pairs of a true box and one of the result that overlap in some step, step by step.

    Args:
        truth: The true boxes.
        result: Those of the result.
        true: (k,) int64, the true box of each pair.
        found: (k,) int64, its box of the result.
        overlap: (k,) float64, their intersection over union, above 0.
    """

    truth: Boxes
    result: Boxes
    true: Int64[np.ndarray, " k"]
    found: Int64[np.ndarray, " k"]
    overlap: Float64[np.ndarray, " k"]

    @property
    def object(self) -> Int64[np.ndarray, " k"]:
        """The true identity of each pair."""
        return self.truth.identity[self.true]

    @property
    def track(self) -> Int64[np.ndarray, " k"]:
        """The given identity of each pair."""
        return self.result.identity[self.found]

    @property
    def step(self) -> Int64[np.ndarray, " k"]:
        """The step of each pair, ascending."""
        return self.truth.step[self.true]

    def contested(self, allowed: Bool[np.ndarray, " k"]) -> Int64[np.ndarray, " steps"]:
        """Steps in which a box is in two or more allowed pairs, so that there is a choice."""
        of_true = np.bincount(self.true[allowed], minlength=len(self.truth.step))
        of_found = np.bincount(self.found[allowed], minlength=len(self.result.step))
        choice = (of_true[self.true] > 1) | (of_found[self.found] > 1)
        return np.unique(self.step[choice & allowed])

    def assign(self, gain: Float64[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
        """The one-to-one assignment of greatest total gain in every step, as a mask of pairs.

        A pair needs a gain above 0.
        """
        chosen = gain > 0
        for step in self.contested(chosen).tolist():
            rows = self.rows(step)
            chosen[rows] = self.assign_step(step, rows, gain[rows])
        return chosen

    def rows(self, step: int) -> slice:
        """Which pairs are of a step."""
        return slice(*np.searchsorted(self.true, self.truth.start[step : step + 2]))

    def assign_step(
        self, step: int, rows: slice, gain: Float64[np.ndarray, " p"]
    ) -> Bool[np.ndarray, " p"]:
        """:meth:`assign` in one step.

        All boxes of the step stand in the matrix, as they do in trackeval, so that of two
        assignments of equal gain both take the same one.
        """
        matrix = np.zeros([np.diff(b.start[step : step + 2])[0] for b in (self.truth, self.result)])
        row = self.true[rows] - self.truth.start[step]
        column = self.found[rows] - self.result.start[step]
        matrix[row, column] = gain
        partner = np.full(len(matrix), -1)
        assigned = linear_sum_assignment(matrix, maximize=True)
        partner[assigned[0]] = assigned[1]
        return (partner[row] == column) & (gain > 0)


def overlaps(result: Tracks, truth: Tracks) -> Overlaps:
    """Who overlaps whom, frame by frame and camera by camera."""
    place = np.concatenate([np.stack([t.camera, t.frame], 1) for t in (truth, result)])
    step = np.unique(place, axis=0, return_inverse=True)[1].reshape(-1)
    steps = int(step.max(initial=-1)) + 1
    true, box_true = _in_steps(truth, step[: len(truth)], steps)
    found, box_found = _in_steps(result, step[len(truth) :], steps)
    parts: list[Any] = [(np.empty(0, dtype=np.int64),) * 2 + (np.empty(0),)]
    bounds = zip(true.start, true.start[1:], found.start, found.start[1:], strict=False)
    for a, b, c, d in bounds:
        overlap = iou(box_true[a:b], box_found[c:d])
        row, column = overlap.nonzero()
        parts.append((row + a, column + c, overlap[row, column]))
    return Overlaps(true, found, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def _in_steps(
    tracks: Tracks, step: Int64[np.ndarray, " n"], steps: int
) -> tuple[Boxes, Float64[np.ndarray, "n 4"]]:
    order = np.argsort(step, kind="stable")
    _, identity, count = np.unique(tracks.identity, return_inverse=True, return_counts=True)
    start = np.searchsorted(step[order], np.arange(steps + 1))
    return Boxes(step[order], identity[order], count, start), tracks.box[order]
