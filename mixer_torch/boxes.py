"""Overlap of boxes, and which boxes of a frame are the same ones."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64
from scipy.optimize import linear_sum_assignment


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
