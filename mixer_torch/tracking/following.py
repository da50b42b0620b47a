"""Frame by frame: which detection goes on which track, and which begins a new one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.optimize import linear_sum_assignment

from mixer_torch.boxes import centred_iou as iou
from mixer_torch.boxes import sizes
from mixer_torch.tracking.evidence import CONTEXT, Frame, Pairs, compared, margins
from mixer_torch.tracking.measured import Measured, Sequence
from mixer_torch.tracking.states import States
from mixer_torch.tracking.weights import Network, Weights

NEIGHBOURHOOD = 1.5  # sizes within which boxes count as neighbours
DETECTION = (
    "meaning",
    "rank",
    "overlap_stronger",
    "overlap",
    "neighbours",
    "covered",
    "size",
    "spread",
    "weaker",
    "alone",
)
"""Features that tell whether a detection is an object, besides its track."""
LARGEST_ODDS = 5.0
SELDOM = 2.3
"""Continuity (log odds of 91 %) at which nothing speaks for a link beforehand."""
Extra = Callable[[States, Frame, Pairs], np.ndarray]
"""Evidence of other modalities for pairs, nats: :mod:`~mixer_torch.tracking.appearance`."""


@dataclass(frozen=True)
class Linking:
    """How detections are put on tracks.

    Args:
        longest_unseen: Time for which a track waits to be seen again, seconds.
        fewest_unseen: Frames that it waits at least, whatever the frame rate.
        link_odds: Log odds to be added to the evidence of a link at most: a track that was there a
            frame ago usually still is. They are less the less what was there goes on, as measured
            (:attr:`Measured.continuity`): where a detector misses much, or things come and go.
        least_odds: Log odds of being an object under which a detection is on no track: what is
            more probably clutter goes on nothing.
        birth_odds: Log odds of being an object from which a detection that is on no track begins
            one.
    """

    longest_unseen: float = 2.0
    fewest_unseen: int = 10
    link_odds: float = 3.0
    least_odds: float = 0.0
    birth_odds: float = 0.5


def described(
    box: Float64[np.ndarray, "m 4"], score: np.ndarray, measured: Measured
) -> Float64[np.ndarray, "m d"]:
    """:data:`DETECTION` of the detections of one frame."""
    m = len(box)
    if not m:
        return np.zeros((0, len(DETECTION)))
    meaning, rank = measured.means(score), measured.rank(score)
    overlap = iou(box[:, None], box[None])
    np.fill_diagonal(overlap, 0)
    order = np.argsort(-score, kind="stable")
    place = np.empty(m, dtype=int)
    place[order] = np.arange(m)
    stronger = place[None] < place[:, None]
    low = np.maximum(*_both(box[:, :2] - box[:, 2:] / 2))
    high = np.minimum(*_both(box[:, :2] + box[:, 2:] / 2))
    covered = np.clip(high - low, 0, None).prod(2) / box[:, 2:].prod(1)[:, None]
    apart = np.hypot(*np.moveaxis(box[:, None, :2] - box[:, :2], 2, 0))
    near = (apart < NEIGHBOURHOOD * sizes(box)[:, None]).sum(1) - 1
    spread = float(np.ptp(measured.meaning)) if len(measured.meaning) else 0.0
    logit = np.log(meaning + 0.02) - np.log(1.02 - meaning)
    top = float(measured.meaning.max(initial=0.0)) if len(measured.meaning) else 0.0
    return np.column_stack(
        [
            logit,
            rank - 0.5,
            (overlap * stronger).max(1),
            overlap.max(1),
            np.log1p(near),
            (covered * stronger).max(1),
            np.log(sizes(box)),
            np.full(m, spread),
            np.log(top + 0.02) - np.log(1.02 - top) - logit,
            np.full(m, measured.alone),
        ]
    )


def _both(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return value[:, None], value[None]


def odds_of_objects(network: Network, description: np.ndarray) -> Float64[np.ndarray, " m"]:
    """Log odds that detections are objects, bounded."""
    return np.clip(network(description), -LARGEST_ODDS, LARGEST_ODDS)


class Follower:
    """Tracks of a sequence up to now; each frame is a step.

    Args:
        weights: What was learned.
        linking: How detections are put on tracks.
        frame_rate: Frames a second.
        extra: Evidence of further modalities.
    """

    def __init__(
        self, weights: Weights, linking: Linking, frame_rate: float, extra: Extra | None = None
    ) -> None:
        self.weights, self.linking, self.extra = weights, linking, extra
        self.longest = max(linking.fewest_unseen, round(linking.longest_unseen * frame_rate))
        self.states = States.none()
        self.begun = 0

    def step(
        self, now: float, frame: Frame, camera: Float64[np.ndarray, " 3"], measured: Measured
    ) -> tuple[Int64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
        """Take in the detections of a frame.

        Args:
            now: Index of the frame.
            frame: What was detected.
            camera: The camera's step from the frame before.
            measured: What is known of the sequence.

        Returns:
            The track of each detection, -1 for none, and the evidence for its link, nats, 0 where
            it begins a track.
        """
        states = self.states.select(now - self.states.seen <= self.longest)
        states.moved(camera)
        pairs, evidence = self.compare(states, frame, now, measured)
        prior = np.clip(measured.continuity - SELDOM, 0, self.linking.link_odds)
        track, detection = self.assign(states, frame, pairs, evidence + prior)
        identity, link = np.full(len(frame.row), -1), np.zeros(len(frame.row))
        identity[detection] = states.identity[track]
        table = np.zeros((len(states), len(frame.row)))
        table[pairs.track, pairs.detection] = evidence
        link[detection] = table[track, detection]
        states.observed(
            track, frame.row[detection], frame.box[detection], now, frame.odds[detection]
        )
        new = np.flatnonzero((identity < 0) & (frame.odds >= self.linking.birth_odds))
        identity[new] = self.begun + np.arange(len(new))
        self.begun += len(new)
        self.states = states.started(
            frame.row[new], frame.box[new], now, frame.odds[new], frame.category[new], identity[new]
        )
        return identity, link

    def compare(
        self, states: States, frame: Frame, now: float, measured: Measured
    ) -> tuple[Pairs, Float64[np.ndarray, " P"]]:
        """Pairs that could be one thing, and the evidence for each: of all modalities together."""
        pairs = compared(states, frame, now, measured)
        evidence = self.weights["evidence"](pairs.features)
        if self.extra is not None:
            evidence = evidence + self.extra(states, frame, pairs)
        return pairs, self.weights["rivals"](with_rivals(pairs, evidence))

    def assign(
        self, states: States, frame: Frame, pairs: Pairs, evidence: Float64[np.ndarray, " P"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """The one-to-one pairs of greatest evidence in sum, each with more for it than against.

        This is the problem of MIXER on two views, tracks and detections, where it is a linear
        assignment.
        """
        counts = (evidence > 0) & (frame.odds[pairs.detection] >= self.linking.least_odds)
        gain = np.zeros((len(states), len(frame.row)))
        gain[pairs.track, pairs.detection] = np.where(counts, evidence, 0)
        track, detection = linear_sum_assignment(gain, maximize=True)
        good = gain[track, detection] > 0
        return track[good], detection[good]


def with_rivals(pairs: Pairs, evidence: Float64[np.ndarray, " P"]) -> Float64[np.ndarray, "P g"]:
    """Features of the second stage: the first one's evidence, margins to rivals, and context."""
    context = pairs.features[:, -len(CONTEXT) :]
    return np.column_stack(
        [evidence, margins(evidence, pairs.track), margins(evidence, pairs.detection), context]
    )


def frame_of(
    sequence: Sequence,
    t: int,
    odds: Float64[np.ndarray, " m"],
    description: Float64[np.ndarray, "m d"],
) -> Frame:
    """The detections of the t-th frame, with what they are by themselves."""
    rows = sequence.rows(t)
    return Frame(
        np.arange(rows.start, rows.stop),
        sequence.box[rows],
        odds,
        description[:, DETECTION.index("overlap")],
        description[:, DETECTION.index("neighbours")],
        sequence.category[rows],
    )
