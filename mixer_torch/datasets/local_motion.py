"""Where things were and how they moved, from the frames around the one that is observed."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from mixer_torch.boxes import match_boxes

MIN_OVERLAP = 0.5
"""Intersection over union from which boxes in frames close by are one object's."""
MAX_GAP = 3
"""Frames from one box of a chain to the next, at most."""


def local_motion(
    frame: Int64[np.ndarray, " n"],
    box: Float64[np.ndarray, "n 4"],
    position: Float64[np.ndarray, "n d"],
    rows: Int64[np.ndarray, " m"],
    frame_rate: float,
    half_width: float,
) -> tuple[Float64[np.ndarray, "m d"], Float64[np.ndarray, "m d"]]:
    """Position and velocity of some rows, from a straight path through their neighbours.

    The neighbours of a box are the boxes of its chain, from frame to frame the assignment of
    greatest overlap, that are at most ``half_width`` seconds away. Over those,

        minimise over p, v    sum_k |position_k - p - v (t_k - t)|²,

    and p is the position, v the velocity. Where the neighbours span less than ``half_width``,
    there is no telling error from motion: the position stays as it was measured, and the velocity
    is NaN.

    Args:
        frame: Frame of each box, of one camera.
        box: x1 y1 x2 y2, pixels.
        position: Metres; NaN where not known.
        rows: Which boxes to give an answer for.
        frame_rate: Frames per second.
        half_width: Of the window, seconds.

    Returns:
        (m, d) metres and (m, d) metres a second.
    """
    before, after = chains(frame, box)
    place, velocity = position[rows], np.full((len(rows), position.shape[1]), np.nan)
    for k, row in enumerate(rows):
        near = [row]
        for link in (before, after):
            other = link[row]
            while other >= 0 and abs(frame[other] - frame[row]) <= half_width * frame_rate:
                near.append(other)
                other = link[other]
        known = np.array(near)[np.isfinite(position[near]).all(1)]
        time = (frame[known] - frame[row]) / frame_rate
        if len(known) > 2 and np.ptp(time) >= half_width:
            path = np.column_stack([np.ones(len(time)), time])
            place[k], velocity[k] = np.linalg.lstsq(path, position[known], rcond=None)[0]
    return place, velocity


def chains(
    frame: Int64[np.ndarray, " n"], box: Float64[np.ndarray, "n 4"]
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """The box before and the box after each, by overlap in frames close by; -1 for none.

    Boxes of neighbouring frames are assigned first, and what is then without a neighbour across
    wider gaps, so a box that is missing in a frame or two does not end a chain.
    """
    before, after = (np.full(len(frame), -1, dtype=np.int64) for _ in range(2))
    for gap in range(1, MAX_GAP + 1):
        a, b = np.flatnonzero(after < 0), np.flatnonzero(before < 0)
        i, j = match_boxes(frame[a] + gap, box[a], frame[b], box[b], MIN_OVERLAP)
        after[a[i]], before[b[j]] = b[j], a[i]
    return before, after
