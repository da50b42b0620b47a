"""Boxes x1 y1 x2 y2: corners, foot points, overlap, and which of them are the same ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from scipy.optimize import linear_sum_assignment
from torch import Tensor

ROUNDING = np.finfo(np.float64).eps
"""How far an overlap may be under a threshold and reach it still, as in trackeval."""


def corners(left_top_size: Float64[np.ndarray, "n 4"]) -> Float64[np.ndarray, "n 4"]:
    """Boxes x1 y1 x2 y2 from left, top, width and height."""
    left_top = left_top_size[:, :2]
    return np.concatenate([left_top, left_top + left_top_size[:, 2:]], 1)


def left_top_size(box: Float64[np.ndarray, "n 4"]) -> Float64[np.ndarray, "n 4"]:
    """Left, top, width and height of boxes x1 y1 x2 y2."""
    return np.concatenate([box[:, :2], box[:, 2:] - box[:, :2]], 1)


def centred(box: Float64[np.ndarray, "n 4"]) -> Float64[np.ndarray, "n 4"]:
    """Middle, width and height (cx cy w h) of boxes x1 y1 x2 y2."""
    return np.concatenate([(box[:, :2] + box[:, 2:]) / 2, box[:, 2:] - box[:, :2]], 1)


def sizes(centred_box: Float64[np.ndarray, "... 4"]) -> Float64[np.ndarray, ...]:
    """The square root of the area of boxes cx cy w h: the length that a box is measured by."""
    return np.sqrt(centred_box[..., 2] * centred_box[..., 3])


def centred_iou(
    a: Float64[np.ndarray, "... 4"], b: Float64[np.ndarray, "... 4"], enlarged: float = 1.0
) -> Float64[np.ndarray, ...]:
    """Intersection over union of boxes cx cy w h with the one in their place, sides enlarged."""
    half_a, half_b = a[..., 2:] * (enlarged / 2), b[..., 2:] * (enlarged / 2)
    low = np.maximum(a[..., :2] - half_a, b[..., :2] - half_b)
    high = np.minimum(a[..., :2] + half_a, b[..., :2] + half_b)
    common = np.clip(high - low, 0, None).prod(-1)
    return common / (4 * (half_a.prod(-1) + half_b.prod(-1)) - common)


def foot_points(box: Float64[np.ndarray, "n 4"]) -> Float64[np.ndarray, "n 2"]:
    """Where each box meets the ground: the middle of its lower edge."""
    return np.column_stack([(box[:, 0] + box[:, 2]) / 2, box[:, 3]])


def intersection(
    a: Float64[np.ndarray, "a 4"], b: Float64[np.ndarray, "b 4"]
) -> Float64[np.ndarray, "a b"]:
    """The area that each box of a has in common with each of b."""
    low = np.maximum(a[:, None, :2], b[:, :2])
    high = np.minimum(a[:, None, 2:], b[:, 2:])
    return (high - low).clip(min=0).prod(-1)


def area(box: Float64[np.ndarray, "n 4"]) -> Float64[np.ndarray, " n"]:
    """Width times height; 0 for a box whose corners are the wrong way round."""
    return (box[:, 2:] - box[:, :2]).clip(min=0).prod(-1)


def iou(a: Float64[np.ndarray, "a 4"], b: Float64[np.ndarray, "b 4"]) -> Float64[np.ndarray, "a b"]:
    """Intersection over union of each box of a with each of b; 0 with a box of no area."""
    common = intersection(a, b)
    union = area(a)[:, None] + area(b) - common
    return common / np.maximum(union, np.finfo(np.float64).tiny)


def paired_iou(a: Float[Tensor, "P 4"], b: Float[Tensor, "P 4"]) -> Float[Tensor, " P"]:
    """Intersection over union of each box of a with the one of b in its place, differentiable."""
    overlap = torch.minimum(a[:, 2:], b[:, 2:]) - torch.maximum(a[:, :2], b[:, :2])
    common = overlap.clamp(min=0).prod(1)
    area_a, area_b = ((x[:, 2:] - x[:, :2]).clamp(min=0).prod(1) for x in (a, b))
    return common / (area_a + area_b - common).clamp(min=torch.finfo(a.dtype).tiny)


def assign(
    overlap: Float64[np.ndarray, "a b"], min_overlap: float
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """The one-to-one assignment of greatest total overlap, where a pair needs ``min_overlap``.

    Returns:
        Rows and columns of the assigned pairs.
    """
    gain = np.where(overlap < min_overlap - ROUNDING, 0, overlap)
    row, column = linear_sum_assignment(gain, maximize=True)
    counts = gain[row, column] > 0
    return row[counts], column[counts]


def check_min_overlap(min_overlap: float) -> None:
    """ValueError unless it is an intersection over union that two boxes can be asked for."""
    if not 0 < min_overlap <= 1:
        raise ValueError(f"min_overlap: expected a value in (0, 1], got {min_overlap}")


def match_boxes(
    frame_a: Any,
    box_a: Float64[np.ndarray, "a 4"],
    frame_b: Any,
    box_b: Float64[np.ndarray, "b 4"],
    min_overlap: float = 0.5,
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """:func:`assign` by intersection over union, frame by frame.

    Args:
        frame_a: (a,) numbers.
        box_a: Boxes.
        frame_b: (b,) numbers.
        box_b: Boxes.
        min_overlap: Intersection over union that a pair needs.

    Returns:
        Indices in a and indices in b of the assigned pairs, in order of frames.
    """
    order_a, order_b = (np.argsort(frame, kind="stable") for frame in (frame_a, frame_b))
    frames = np.intersect1d(frame_a, frame_b)
    rows = [np.empty((2, 0), dtype=np.int64)]
    for a, b in zip(
        _rows_of(frames, frame_a[order_a], order_a),
        _rows_of(frames, frame_b[order_b], order_b),
        strict=True,
    ):
        row, column = assign(iou(box_a[a], box_b[b]), min_overlap)
        rows.append(np.stack([a[row], b[column]]))
    first, second = np.concatenate(rows, 1)
    return first, second


def true_identities(
    frame: Any,
    box: Float64[np.ndarray, "m 4"],
    true_frame: Any,
    true_box: Float64[np.ndarray, "n 4"],
    true_identity: Any,
    min_overlap: float = 0.5,
) -> Int64[np.ndarray, " m"]:
    """The identity of the true box that each box is matched to, -1 for clutter."""
    identity = np.full(len(box), -1, dtype=np.int64)
    mine, theirs = match_boxes(frame, box, true_frame, true_box, min_overlap)
    identity[mine] = true_identity[theirs]
    return identity


def _rows_of(frames: np.ndarray, ordered: np.ndarray, order: np.ndarray) -> list[np.ndarray]:
    """The rows of each of some frames, where ``ordered`` are the frames of rows ``order``."""
    start, stop = (np.searchsorted(ordered, frames, side=side) for side in ("left", "right"))
    return [order[i:j] for i, j in zip(start, stop, strict=True)]
