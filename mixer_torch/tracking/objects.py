"""Which tracks are objects and which are clutter, by what all of their boxes say together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

TRACK = (
    "odds_mean",
    "odds_best",
    "boxes",
    "seen_share",
    "overlap_stronger",
    "link_mean",
    "rank_mean",
    "objects_sum",
    "meaning_mean",
    "doubt_sum",
)
"""Features of a whole track; sums let many weak boxes say as much as a few strong ones."""
LARGEST_LINK = 6.0  # nats


@dataclass(frozen=True)
class Boxes:
    """What is known of each detection when tracks are judged: all (n,).

    Args:
        label: The track of each, -1 for none.
        frame: Index of its frame.
        odds: Log odds of being an object.
        overlap: The greatest IoU with a box of the frame that has a higher score.
        link: Evidence of the link to the box before, nats.
        rank: Where its score stands among all.
        meaning: How often detections of its score go on.
        most_overlap: The greatest IoU with any other box of the frame.
        neighbours: log(1 + boxes close by).
    """

    label: Int64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    odds: Float64[np.ndarray, " n"]
    overlap: Float64[np.ndarray, " n"]
    link: Float64[np.ndarray, " n"]
    rank: Float64[np.ndarray, " n"]
    meaning: Float64[np.ndarray, " n"]
    most_overlap: Float64[np.ndarray, " n"]
    neighbours: Float64[np.ndarray, " n"]

    def relabelled(self, label: Int64[np.ndarray, " n"]) -> Boxes:
        """The same detections on other tracks."""
        return replace(self, label=label)


def track_features(boxes: Boxes) -> Float64[np.ndarray, "k 10"]:
    """(k, 10) :data:`TRACK` of the tracks 0..k-1, each of which has a box."""
    row = np.flatnonzero(boxes.label >= 0)
    label = boxes.label[row]
    count = np.bincount(label)
    k = len(count)

    def total(value: np.ndarray) -> np.ndarray:
        return np.bincount(label, value[row], k)

    def extreme(value: np.ndarray, function: np.ufunc, start: float) -> np.ndarray:
        out = np.full(k, start)
        function.at(out, label, value[row])
        return out

    first = extreme(boxes.frame, np.minimum, np.inf)
    last = extreme(boxes.frame, np.maximum, -np.inf)
    return np.column_stack(
        [
            total(boxes.odds) / count,
            extreme(boxes.odds, np.maximum, -np.inf),
            np.log(count),
            count / (last - first + 1),
            total(boxes.overlap) / count,
            total(np.minimum(boxes.link, LARGEST_LINK)) / count,
            total(boxes.rank) / count,
            np.log1p(total(1 / (1 + np.exp(-boxes.odds)))),
            total(boxes.meaning) / count,
            np.log1p(total(np.maximum(-boxes.odds, 0))),
        ]
    )


def numbered(label: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Labels 0.. in order of first appearance; -1 stays."""
    out = np.full(len(label), -1)
    row = np.flatnonzero(label >= 0)
    _, first, inverse = np.unique(label[row], return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    out[row] = rank[inverse.reshape(-1)]
    return out
