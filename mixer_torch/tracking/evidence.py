"""Modalities of tracking: what a track and a detection say for and against being one thing."""

from __future__ import annotations

from collections.abc import Sequence as Listed
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from mixer_torch.boxes import centred_iou as iou
from mixer_torch.boxes import sizes
from mixer_torch.tracking.measured import Measured
from mixer_torch.tracking.states import HYPOTHESES, States, predicted

ENLARGED = 1.8
"""Sides of the enlarged boxes: boxes that just miss each other still say something."""
GATE, GATE_A_FRAME, GATE_FRAMES = 1.2, 0.4, 10.0
"""Offset up to which a pair is looked at, sizes: and this much more for each frame unseen."""
GATE_SHAPE = (1.2, 1.0)
"""Nats of width and of height by which a pair may differ."""
LEAST_JITTER = 0.002  # sizes: that of boxes rounded to pixels
NONE = -10.0
"""Evidence of a rival where there is none, nats."""
LARGEST_MARGIN = 6.0

CONTEXT = (
    "gap",
    "hits",
    "crowd_track",
    "crowd",
    "neighbours",
    "motion",
    "change",
    "jitter",
    "continuity",
)
"""Covariates, which every modality sees: they say nothing by themselves, but what others mean."""
MODALITIES = {
    "overlap": (
        *(f"iou_{k}" for k in range(4)),
        "iou_best",
        *(f"wide_{k}" for k in (0, 2, 3)),
    ),
    "motion": (
        *(f"offset_{k}" for k in range(4)),
        "offset_best",
        "rest_by_motion",
        "short_by_change",
        "best_by_change",
        "direction",
        "speed",
        "speed_now",
    ),
    "edges": ("top", "bottom", "top_or_bottom", "left_or_right", "left_and_right"),
    "shape": ("height_short", "width_short", "height_long", "area"),
    "score": ("odds", "odds_latest", "odds_change"),
    "rivals": ("evidence", "margin_track", "margin_detection"),
}
"""Features of each modality. Rivals are a second stage: how much better the pair is than the best
other pair of the track, and of the detection, in the frame (Lowe's ratio test, for boxes)."""
FIRST_STAGE = tuple(name for name in MODALITIES if name != "rivals")
FEATURES = (*(name for key in FIRST_STAGE for name in MODALITIES[key]), *CONTEXT)
COLUMN = {name: k for k, name in enumerate(FEATURES)}


@dataclass(frozen=True)
class Frame:
    """Detections of one frame, described.

    Args:
        row: (m,) which of the sequence.
        box: (m, 4) cx cy w h, units of the sequence.
        odds: (m,) log odds of being an object, by its score and its neighbours.
        overlap: (m,) the greatest IoU with another box of the frame.
        neighbours: (m,) log(1 + boxes within one and a half sizes).
        category: (m,).
    """

    row: Int64[np.ndarray, " m"]
    box: Float64[np.ndarray, "m 4"]
    odds: Float64[np.ndarray, " m"]
    overlap: Float64[np.ndarray, " m"]
    neighbours: Float64[np.ndarray, " m"]
    category: Int64[np.ndarray, " m"]


@dataclass(frozen=True)
class Pairs:
    """Pairs of tracks and detections of a frame that could be one thing.

    Args:
        track: (P,) index of the track.
        detection: (P,) index in the frame.
        features: (P, F) :data:`FEATURES`.
    """

    track: Int64[np.ndarray, " P"]
    detection: Int64[np.ndarray, " P"]
    features: Float64[np.ndarray, "P F"]


def compared(states: States, frame: Frame, now: float, measured: Measured) -> Pairs:
    """The pairs of a frame that could be one thing, and what is seen of each.

    Args:
        states: The tracks, in the coordinates of this frame.
        frame: The detections.
        now: The frame's index.
        measured: What a motion is measured by.
    """
    boxes, velocity = predicted(states, now)
    gap = now - states.seen
    detection = frame.box[None]
    size = np.sqrt(sizes(states.history[:, -1, :4])[:, None] * sizes(frame.box))
    offset = np.hypot(*np.moveaxis(detection[:, :, None, :2] - boxes[:, None, :, :2], -1, 0))
    offset = offset / size[:, :, None]
    growth = np.abs(np.log(detection[:, :, 2:] / boxes[:, None, 0, 2:]))
    gate = GATE + GATE_A_FRAME * np.minimum(gap, GATE_FRAMES)
    near = (offset.min(2) <= gate[:, None]) & (growth <= np.array(GATE_SHAPE)).all(2)
    near &= states.category[:, None] == frame.category
    track, column = np.nonzero(near)
    crowd = _mutual_overlap(boxes[:, 2])[track]
    seen = frame.odds[column], frame.overlap[column], frame.neighbours[column]
    features = _features(
        states.select(track), boxes[track], velocity[track], gap[track], frame.box[column],
        offset[track, column], size[track, column], seen, crowd, measured,
    )  # fmt: skip
    return Pairs(track, column, features)


def compared_pairwise(
    states: States,
    box: Float64[np.ndarray, "P 4"],
    now: Float64[np.ndarray, " P"],
    seen: Listed[np.ndarray],
    measured: Measured,
) -> Float64[np.ndarray, "P F"]:
    """Features of each track with one box of its own, each at a frame of its own.

    Args:
        states: P tracks.
        box: Their boxes cx cy w h.
        now: The frames of these.
        seen: (P,) each: odds, overlap and neighbours of the boxes.
        measured: What a motion is measured by.
    """
    boxes, velocity = predicted(states, now)
    size = np.sqrt(sizes(states.history[:, -1, :4]) * sizes(box))
    offset = np.hypot(*np.moveaxis(box[:, None, :2] - boxes[:, :, :2], -1, 0)) / size[:, None]
    alone = np.zeros(len(box))
    return _features(
        states, boxes, velocity, now - states.seen, box, offset, size, seen, alone, measured
    )


def _mutual_overlap(box: Float64[np.ndarray, "n 4"]) -> Float64[np.ndarray, " n"]:
    """The greatest IoU of each box with another one."""
    overlap = iou(box[:, None], box[None])
    np.fill_diagonal(overlap, 0)
    return overlap.max(1, initial=0)


def _compressed(value: np.ndarray) -> np.ndarray:
    """Distances on a scale on which small ones are told apart."""
    return np.log1p(10 * np.abs(value))


def _features(
    states: States,
    boxes: np.ndarray,
    velocity: np.ndarray,
    gap: np.ndarray,
    box: np.ndarray,
    offset: np.ndarray,
    size: np.ndarray,
    seen: Listed[np.ndarray],
    crowd: np.ndarray,
    measured: Measured,
) -> Float64[np.ndarray, "P F"]:
    """:data:`FEATURES` of P pairs: of each a track, where it would be, and a detection."""
    odds, overlap, neighbours = seen
    last = states.history[:, -1]
    columns = [
        *_overlap(boxes, box),
        *_motion(boxes, velocity, last, gap, box, offset, size, measured),
        *_edges(boxes[:, 2], box, size),
        *_shape(boxes, box, last),
        odds,
        states.latest,
        np.abs(odds - states.objectness),
        np.log(gap),
        np.log(np.minimum(states.hits, 30.0)),
        crowd,
        overlap,
        neighbours,
        np.full(len(box), np.log(measured.motion)),
        np.full(len(box), np.log(measured.change)),
        np.full(len(box), np.log(measured.jitter + LEAST_JITTER)),
        np.full(len(box), measured.continuity),
    ]
    return np.column_stack(columns)


def _overlap(boxes: np.ndarray, box: np.ndarray) -> list[np.ndarray]:
    overlap = [iou(boxes[:, k], box) for k in range(len(HYPOTHESES))]
    wide = [iou(boxes[:, k], box, ENLARGED) for k in (0, 2, 3)]
    return [*overlap, np.max(overlap, 0), *wide]


def _motion(
    boxes: np.ndarray,
    velocity: np.ndarray,
    last: np.ndarray,
    gap: np.ndarray,
    box: np.ndarray,
    offset: np.ndarray,
    size: np.ndarray,
    measured: Measured,
) -> list[np.ndarray]:
    best = offset.min(1)
    rest_scale = measured.motion * gap**0.8 + 0.01  # between a random walk and a straight line
    change_scale = measured.change * gap + 0.01
    now = (box[:, :2] - last[:, :2]) / gap[:, None] / size[:, None]
    speed, speed_now = np.hypot(*velocity.T) / size, np.hypot(*now.T)
    along = (velocity / size[:, None] * now).sum(1)
    return [
        *_compressed(offset).T,
        _compressed(best),
        np.log1p(offset[:, 0] / rest_scale),
        np.log1p(offset[:, 2] / change_scale),
        np.log1p(best / change_scale),
        along / ((speed + measured.change) * (speed_now + measured.change)),
        _compressed(speed),
        _compressed(speed_now),
    ]


def _edges(short: np.ndarray, box: np.ndarray, size: np.ndarray) -> list[np.ndarray]:
    """Where a thing is partly hidden, one edge of its box stays where it would be."""
    low = np.abs(box[:, :2] - box[:, 2:] / 2 - short[:, :2] + short[:, 2:] / 2) / size[:, None]
    high = np.abs(box[:, :2] + box[:, 2:] / 2 - short[:, :2] - short[:, 2:] / 2) / size[:, None]
    return [
        _compressed(low[:, 1]),
        _compressed(high[:, 1]),
        _compressed(np.minimum(low[:, 1], high[:, 1])),
        _compressed(np.minimum(low[:, 0], high[:, 0])),
        _compressed(np.maximum(low[:, 0], high[:, 0])),
    ]


def _shape(boxes: np.ndarray, box: np.ndarray, last: np.ndarray) -> list[np.ndarray]:
    return [
        _compressed(np.log(box[:, 3] / boxes[:, 2, 3])),
        _compressed(np.log(box[:, 2] / boxes[:, 2, 2])),
        _compressed(np.log(box[:, 3] / boxes[:, 3, 3])),
        _compressed(np.log(box[:, 2:].prod(1) / last[:, 2:4].prod(1))),
    ]


def margins(
    evidence: Float64[np.ndarray, " P"], group: Int64[np.ndarray, " P"]
) -> Float64[np.ndarray, " P"]:
    """By how much each pair is better than the best other pair of its group, nats, bounded."""
    if not len(evidence):
        return evidence
    count = int(group.max()) + 1
    order = np.lexsort((evidence, group))
    last = np.searchsorted(group[order], np.arange(count), side="right") - 1
    best = np.full(count, NONE)
    present = np.bincount(group, minlength=count) > 0
    best[present] = evidence[order[last[present]]]
    several = np.bincount(group, minlength=count) > 1
    second = np.full(count, NONE)
    second[several] = evidence[order[last[several] - 1]]
    is_best = np.zeros(len(evidence), dtype=bool)
    is_best[order[last[present]]] = True
    rival = np.where(is_best, second[group], best[group])
    return np.minimum(evidence - rival, LARGEST_MARGIN)
