"""Tracks while they are followed: what was seen of each lately, and where it may be next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

MEMORY = 12
"""Boxes remembered of each track: about half a second, over which velocities are told."""
SHORT, LONG, FOR_SIZE = 4, 10, 8
"""Boxes that the short and the long velocity, and the trend of the size, are fitted to."""
FARTHEST = 12.0
"""Frames over which the long velocity and the trend of the size are trusted."""
LARGEST_TREND = 0.3
"""Nats by which a trend may change a side."""
HYPOTHESES = ("rests", "goes on as last", "short velocity", "long velocity")


@dataclass
class States:
    """n tracks, as a struct of arrays that grows and shrinks.

    Args:
        history: (n, MEMORY, 5) cx cy w h and frame of the latest boxes, the newest last, in the
            coordinates of the present frame.
        count: (n,) how many of them there are.
        hits: (n,) boxes in all.
        identity: (n,) the track's number.
        category: (n,) of its detections.
        objectness: (n,) running mean of the log odds that its boxes are objects.
        latest: (n,) that of the latest box.
        row: (n,) the latest detection.
    """

    history: Float64[np.ndarray, "n k 5"]
    count: Int64[np.ndarray, " n"]
    hits: Int64[np.ndarray, " n"]
    identity: Int64[np.ndarray, " n"]
    category: Int64[np.ndarray, " n"]
    objectness: Float64[np.ndarray, " n"]
    latest: Float64[np.ndarray, " n"]
    row: Int64[np.ndarray, " n"]

    @classmethod
    def none(cls) -> States:
        """No track."""
        whole = np.zeros(0, dtype=np.int64)
        real = np.zeros(0)
        history = np.zeros((0, MEMORY, 5))
        return cls(history, whole, whole, whole, whole, real, real, whole)

    def __len__(self) -> int:
        return len(self.count)

    @property
    def seen(self) -> Float64[np.ndarray, " n"]:
        """The frame in which each was seen last."""
        return self.history[:, -1, 4]

    def select(self, keep: np.ndarray) -> States:
        """Some of the tracks."""
        return States(*(value[keep] for value in vars(self).values()))

    def moved(self, step: Float64[np.ndarray, " 3"]) -> None:
        """Follow the camera to the next frame, in place."""
        scale, x, y = step
        self.history[:, :, :4] *= scale
        self.history[:, :, 0] += x
        self.history[:, :, 1] += y

    def observed(
        self, track: np.ndarray, row: np.ndarray, box: np.ndarray, frame: float, odds: np.ndarray
    ) -> None:
        """Add a box to each of some tracks, in place."""
        self.history[track, :-1] = self.history[track, 1:]
        self.history[track, -1, :4] = box
        self.history[track, -1, 4] = frame
        self.count[track] = np.minimum(self.count[track] + 1, MEMORY)
        self.hits[track] += 1
        weight = np.maximum(0.2, 1 / self.hits[track])
        self.objectness[track] += weight * (odds - self.objectness[track])
        self.latest[track] = odds
        self.row[track] = row

    def started(
        self,
        row: np.ndarray,
        box: np.ndarray,
        frame: float,
        odds: np.ndarray,
        category: np.ndarray,
        identity: np.ndarray,
    ) -> States:
        """These tracks and new ones, of one box each."""
        n = len(row)
        history = np.zeros((n, MEMORY, 5))
        history[:, -1, :4] = box
        history[:, -1, 4] = frame
        ones = np.ones(n, dtype=np.int64)
        new = States(history, ones, ones.copy(), identity, category, odds, odds.copy(), row)
        pairs = zip(vars(self).values(), vars(new).values(), strict=True)
        return States(*(np.concatenate(pair) for pair in pairs))


def trend(
    history: Float64[np.ndarray, "n k 5"],
    count: Int64[np.ndarray, " n"],
    value: np.ndarray,
    most: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares lines through the latest values of each track.

    Args:
        history: Of the tracks; the newest box is the last.
        count: (n,) how many boxes there are of each.
        value: (n, k, c) what the lines are fitted to.
        most: Boxes at most.

    Returns:
        (n, c) slopes, per frame, and (n, c) values at the newest box.
    """
    size = history.shape[1]
    weight = (np.arange(size) >= size - np.minimum(count, most)[:, None]).astype(float)
    time = (history[:, :, 4] - history[:, -1:, 4]) * weight
    number = weight.sum(1)[:, None]
    mean_time = time.sum(1, keepdims=True) / number
    mean = (value * weight[:, :, None]).sum(1) / number
    centred = (time - mean_time) * weight
    square = (centred**2).sum(1)[:, None]
    slope = (centred[:, :, None] * value).sum(1) / np.where(square > 0, square, 1.0)
    return slope, mean - slope * mean_time


def predicted(
    states: States, frame: float | Float64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "n 4 4"], Float64[np.ndarray, "n 2"]]:
    """Boxes cx cy w h of each track at a frame, or each at its own, by each of :data:`HYPOTHESES`.

    Returns:
        (n, 4, 4) the boxes, and (n, 2) the long velocity, units a frame.
    """
    history, count = states.history, states.count
    last, before = history[:, -1], history[:, -2]
    gap = (frame - last[:, 4])[:, None]
    boxes = np.repeat(last[:, None, :4], len(HYPOTHESES), 1)
    several = (count >= 2)[:, None]
    apart = np.where(several[:, 0], last[:, 4] - before[:, 4], 1.0)[:, None]
    boxes[:, 1, :2] += np.where(several, (last[:, :2] - before[:, :2]) / apart, 0.0) * gap
    place = history[:, :, :2]
    slope, now = trend(history, count, place, SHORT)
    boxes[:, 2, :2] = now + slope * gap
    velocity, now = trend(history, count, place, LONG)
    near = np.minimum(gap, FARTHEST)
    boxes[:, 3, :2] = (last[:, :2] + now) / 2 + velocity * near
    side = np.log(np.where(history[:, :, 2:4] > 0, history[:, :, 2:4], 1.0))
    growth, level = trend(history, count, side, FOR_SIZE)
    change = np.clip(growth * near, -LARGEST_TREND, LARGEST_TREND)
    mean = _mean(side, count, 3)
    boxes[:, 2, 2:] = np.exp(mean)
    boxes[:, 3, 2:] = np.exp(np.where((count >= 4)[:, None], level + change, mean))
    return boxes, velocity


def _mean(value: np.ndarray, count: np.ndarray, most: int) -> np.ndarray:
    """The mean of the latest values of each track."""
    size = value.shape[1]
    weight = np.arange(size) >= size - np.minimum(count, most)[:, None]
    return (value * weight[:, :, None]).sum(1) / weight.sum(1)[:, None]
