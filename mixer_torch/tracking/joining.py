"""Tracks joined over longer gaps, all at once, by MIXER: each end compared with each beginning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64, Int64

from mixer_torch.affinity import Affinity
from mixer_torch.boxes import sizes
from mixer_torch.fusion import LogOddsFusion
from mixer_torch.solvers.base import solve
from mixer_torch.solvers.mixer import Mixer
from mixer_torch.solvers.problem import Solver
from mixer_torch.tracking.evidence import COLUMN, LEAST_JITTER, compared_pairwise, margins
from mixer_torch.tracking.measured import Measured, Sequence
from mixer_torch.tracking.states import MEMORY, States, trend
from mixer_torch.tracking.weights import Weights

JOIN = (
    "from_end",
    "from_beginning",
    "least",
    "margin_end",
    "margin_beginning",
    "overlap_end",
    "overlap_beginning",
    "bridge",
    "bridge_by_error",
    "turn",
    "height",
    "width",
    "gap",
    "boxes_before",
    "boxes_after",
    "motion",
    "change",
    "jitter",
    "continuity",
)
"""Features of a gap: the evidence from either side, and by how much it beats the best rival."""
REACH, REACH_A_FRAME, REACH_FRAMES = 1.5, 0.3, 20.0
"""Offset up to which two ends are compared, sizes, and how it grows with the gap."""
LARGEST = 6.0
"""Nats of a join at most: one gap is one fact."""


@dataclass(frozen=True)
class Joining:
    """How tracks are joined over gaps.

    Args:
        longest_gap: Seconds between the end of one and the beginning of the next; 0 for not at all,
            as on families that the weights have not seen it does not help.
        join_odds: Log odds to be added to the evidence of a gap.
        rounds: How often: joined tracks know their velocities better.
        solver: What decides; :class:`Mixer` with few restarts if None.
    """

    longest_gap: float = 0.0
    join_odds: float = 0.0
    rounds: int = 2
    solver: Solver | None = None


@dataclass(frozen=True)
class Ends:
    """Pairs of tracks, one of which begins after the other has ended.

    Args:
        before: (P,) the one that ends.
        after: (P,) the one that begins.
        features: (P, 19) :data:`JOIN`.
    """

    before: Int64[np.ndarray, " P"]
    after: Int64[np.ndarray, " P"]
    features: Float64[np.ndarray, "P 19"]


def at_rest(sequence: Sequence, camera: Float64[np.ndarray, "T 3"]) -> Float64[np.ndarray, "n 4"]:
    """Boxes cx cy w h as the camera of the first frame would have seen them."""
    scale, shift = np.ones(len(camera)), np.zeros((len(camera), 2))
    for t in range(1, len(camera)):
        scale[t] = camera[t, 0] * scale[t - 1]
        shift[t] = camera[t, 0] * shift[t - 1] + camera[t, 1:]
    frame = sequence.frame
    box = sequence.box / scale[frame, None]
    box[:, :2] -= shift[frame] / scale[frame, None]
    return box


def ends(
    label: Int64[np.ndarray, " n"],
    sequence: Sequence,
    resting: Float64[np.ndarray, "n 4"],
    description: tuple[np.ndarray, np.ndarray, np.ndarray],
    measured: Measured,
    weights: Weights,
    longest: int,
) -> Ends:
    """What is seen of every pair of tracks that could be one object before and after a gap.

    Args:
        label: Tracks 0..k-1 of the detections, -1 for none.
        sequence: The detections.
        resting: Their boxes with the camera's motion taken out.
        description: (n,) odds of being objects, overlap and neighbours of the detections.
        measured: What a motion is measured by.
        weights: What was learned.
        longest: Frames of a gap at most.
    """
    tails, first, last = _states(label, sequence, resting, description[0], False)
    heads, *_ = _states(label, sequence, resting, description[0], True)
    before, after = _candidates(tails, heads, sequence, first, last, longest)
    frame = sequence.frame
    gap = (frame[first[after]] - frame[last[before]]).astype(float)

    def side(states: States, own: np.ndarray, row: np.ndarray, now: np.ndarray) -> np.ndarray:
        crowd = [column[row] for column in description]
        return compared_pairwise(states.select(own), resting[row], now, crowd, measured)

    forwards = side(tails, before, first[after], frame[first[after]].astype(float))
    backwards = side(heads, after, last[before], -frame[last[before]].astype(float))
    bridge = _bridge(tails.select(before), heads.select(after), gap, measured)
    x, y = (weights["evidence"](features) for features in (forwards, backwards))
    least = np.minimum(x, y)
    features = [
        x,
        y,
        least,
        margins(least, before),
        margins(least, after),
        forwards[:, COLUMN["iou_best"]],
        backwards[:, COLUMN["iou_best"]],
        *bridge,
        np.log(np.maximum(gap, 1)),
        np.log(tails.hits[before]),
        np.log(tails.hits[after]),
        np.full(len(x), np.log(measured.motion)),
        np.full(len(x), np.log(measured.change)),
        np.full(len(x), np.log(measured.jitter + LEAST_JITTER)),
        np.full(len(x), measured.continuity),
    ]
    return Ends(before, after, np.column_stack(features))


def _bridge(
    tails: States, heads: States, gap: Float64[np.ndarray, " P"], measured: Measured
) -> list[np.ndarray]:
    """How well a straight line of the mean velocity of both sides leads from one to the other.

    Lines are fitted to all boxes remembered, so a single bad box at an end says little. The error
    of a velocity over n frames is about sqrt(12 / n^3) of the jitter of a box.
    """
    sides = []
    for states in (tails, heads):
        count = states.count
        velocity, place = trend(states.history, count, states.history[:, :, :2], MEMORY)
        side = np.log(np.maximum(states.history[:, :, 2:4], 1e-9))
        known = np.arange(MEMORY) >= MEMORY - count[:, None]
        mean = (side * known[:, :, None]).sum(1) / count[:, None]
        sides.append((velocity, place, mean, np.sqrt(12 / np.maximum(count, 2.0) ** 3)))
    (u, a, shape_a, error_a), (v, b, shape_b, error_b) = sides
    v = -v  # time runs backwards there
    size = np.exp((shape_a + shape_b).sum(1) / 4)
    miss = np.hypot(*(b - a - (u + v) / 2 * gap[:, None]).T) / size
    jitter = measured.jitter + LEAST_JITTER
    error = jitter * (1 + gap * (error_a + error_b) / 2) + measured.change * np.sqrt(gap)
    turn = np.hypot(*(u - v).T) / size
    return [
        np.log1p(10 * miss),
        np.log1p(miss / error),
        np.log1p(turn / (jitter * (error_a + error_b) + measured.change)),
        *np.log1p(10 * np.abs(shape_a - shape_b)[:, ::-1]).T,
    ]


def _states(
    label: np.ndarray, sequence: Sequence, resting: np.ndarray, odds: np.ndarray, backwards: bool
) -> tuple[States, np.ndarray, np.ndarray]:
    """The tracks as they end, or as they begin with time running backwards; first and last rows."""
    sign = -1 if backwards else 1
    row = np.flatnonzero(label >= 0)
    frame = sequence.frame
    order = row[np.lexsort((sign * frame[row], label[row]))]
    count = np.bincount(label[row])
    stop = np.cumsum(count)
    k = len(count)
    place = stop[:, None] - np.arange(MEMORY, 0, -1)
    valid = place >= (stop - count)[:, None]
    latest = order[np.where(valid, place, stop[:, None] - 1)]
    history = np.zeros((k, MEMORY, 5))
    history[:, :, :4] = resting[latest]
    history[:, :, 4] = sign * frame[latest]
    history[~valid] = 0
    mean = np.bincount(label[row], odds[row], k) / count
    end = order[stop - 1]
    begin = order[stop - count]
    states = States(
        history, np.minimum(count, MEMORY), count, np.arange(k), sequence.category[end], mean,
        odds[end], end,
    )  # fmt: skip
    return states, (end if backwards else begin), (begin if backwards else end)


def _candidates(
    tails: States,
    heads: States,
    sequence: Sequence,
    first: np.ndarray,
    last: np.ndarray,
    longest: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Tracks that end not too long before another begins, not too far from it."""
    frame = sequence.frame
    start, end = frame[first], frame[last]
    order = np.argsort(start, kind="stable")
    low = np.searchsorted(start[order], end + 1)
    high = np.searchsorted(start[order], end + longest, side="right")
    size = np.maximum(high - low, 0)
    before = np.repeat(np.arange(len(end)), size)
    within = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
    after = order[np.repeat(low, size) + within]
    a, b = tails.history[before, -1, :4], heads.history[after, -1, :4]
    gap = (start[after] - end[before]).astype(float)
    scale = np.sqrt(sizes(a) * sizes(b))
    speed = [_velocity(states)[own] for states, own in ((tails, before), (heads, after))]
    apart = b[:, :2] - a[:, :2]
    offsets = [
        np.hypot(*(apart - moved).T)
        for moved in (0.0, speed[0] * gap[:, None], -speed[1] * gap[:, None])
    ]
    reach = REACH + REACH_A_FRAME * np.minimum(gap, REACH_FRAMES)
    near = np.min(offsets, 0) <= reach * scale
    near &= np.abs(np.log(b[:, 3] / a[:, 3])) < 1
    near &= tails.category[before] == heads.category[after]
    return before[near], after[near]


def _velocity(states: States) -> Float64[np.ndarray, "k 2"]:
    """From the oldest to the newest box remembered, units a frame."""
    oldest = states.history[np.arange(len(states)), MEMORY - states.count]
    newest = states.history[:, -1]
    time = np.maximum(newest[:, 4] - oldest[:, 4], 1)
    return (newest[:, :2] - oldest[:, :2]) / time[:, None]


def joined(
    label: Int64[np.ndarray, " n"],
    sequence: Sequence,
    description: tuple[np.ndarray, np.ndarray, np.ndarray],
    measured: Measured,
    weights: Weights,
    joining: Joining,
    frame_rate: float,
) -> Int64[np.ndarray, " n"]:
    """Labels with tracks joined over gaps: the clusters of least cost, no two at the same time.

    Each pair's evidence is a log likelihood ratio; MIXER decides on all of them at once.
    """
    if joining.longest_gap <= 0 or label.max(initial=-1) < 1:
        return label
    resting = at_rest(sequence, measured.camera)
    longest = max(1, round(joining.longest_gap * frame_rate))
    for _ in range(joining.rounds):
        pairs = ends(label, sequence, resting, description, measured, weights, longest)
        evidence = weights["joins"](pairs.features) + joining.join_odds
        if not (evidence > 0).any():
            break
        group = _solved(label, sequence, pairs, evidence, joining.solver)
        label = np.where(label >= 0, group[np.maximum(label, 0)], -1)
    return label


def _solved(
    label: np.ndarray, sequence: Sequence, pairs: Ends, evidence: np.ndarray, solver: Solver | None
) -> Int64[np.ndarray, " k"]:
    """The cluster of each track, 0.. in order of the first track."""
    k = int(label.max()) + 1
    score = torch.from_numpy(1 / (1 + np.exp(-np.clip(evidence, -LARGEST, LARGEST))))
    chosen = np.stack([pairs.before, pairs.after])
    affinity = Affinity(
        torch.from_numpy(np.sort(chosen, 0)), score[None], torch.full((k,), -1), ("join",)
    )
    apart = torch.from_numpy(_together(label, sequence))
    answer = solve(
        affinity, solver or Mixer(restarts=10), LogOddsFusion(cap=LARGEST), cannot_link=apart
    )
    return answer.labels.numpy()  # type: ignore[union-attr]


def _together(label: np.ndarray, sequence: Sequence) -> Int64[np.ndarray, "2 K"]:
    """Pairs of tracks that are in the picture at the same time."""
    row = np.flatnonzero(label >= 0)
    frame, k = sequence.frame[row], int(label.max()) + 1
    first, last = np.full(k, np.iinfo(np.int64).max), np.full(k, -1)
    np.minimum.at(first, label[row], frame)
    np.maximum.at(last, label[row], frame)
    order = np.argsort(first, kind="stable")
    stop = np.searchsorted(first[order], last[order], side="right")
    size = stop - np.arange(k) - 1
    a = np.repeat(np.arange(k), size)
    b = a + 1 + np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
    return np.sort(np.stack([order[a], order[b]]), 0)
