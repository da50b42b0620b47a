"""Tracking while frames come in: the state between them, and which tracks are shown."""

from __future__ import annotations

from typing import Any

import numpy as np

from mixer_torch.boxes import centred, sizes
from mixer_torch.tracking.evidence import Frame
from mixer_torch.tracking.following import (
    DETECTION,
    Follower,
    described,
    odds_of_objects,
)
from mixer_torch.tracking.measured import known_scores
from mixer_torch.tracking.objects import Boxes, track_features
from mixer_torch.tracking.running import Running


class Stream:
    """A sequence of which one frame comes after the other.

    Args:
        follower: Puts detections on tracks.
        across_categories: Whether a track may be of several categories.
        object_odds: Log odds of being an object from which a track is shown.
    """

    def __init__(self, follower: Follower, across_categories: bool, object_odds: float) -> None:
        self.follower, self.across_categories = follower, across_categories
        self.object_odds = object_odds
        self.running: Running | None = None
        self.count = 0
        self.shown: dict[int, int] = {}  # identities told, by the follower's number
        self.evidence: dict[int, list[list[float]]] = {}  # of the tracks that are not shown yet

    def update(self, detections: Any) -> Any:
        """The detections of the next frame that are on a track, with ``tracker_id``."""
        n = len(detections)
        box = np.asarray(detections.xyxy, dtype=np.float64).reshape(n, 4)
        good = np.isfinite(box).all(1) & (box[:, 2:] > box[:, :2]).all(1)
        row = np.flatnonzero(good)
        if self.running is None:
            if not len(row):
                self.count += 1
                return self._told(detections, row[:0], row[:0])
            corners = box[row]
            self.running = Running(float(np.median(sizes(centred(corners)))))
        unit = self.running.measured.unit
        confidence = detections.confidence
        given = np.ones(n) if confidence is None else np.asarray(confidence, dtype=np.float64)
        score = known_scores(given)
        kind = None if self.across_categories else detections.class_id
        category = np.zeros(n, dtype=np.int64) if kind is None else np.asarray(kind)
        identity = self._followed(centred(box[row]) / unit, score[row], category[row])
        self.count += 1
        told = np.array([self.shown.get(int(i), 0) for i in identity], dtype=np.int64)
        return self._told(detections, row[told > 0], told[told > 0])

    def _followed(self, box: np.ndarray, score: np.ndarray, category: np.ndarray) -> np.ndarray:
        """The follower's number of each detection, -1 for none."""
        running = self.running
        if running is None:
            return np.zeros(0, dtype=np.int64)
        step = running.add(box, score, category)
        measured = running.measured
        description = described(box, score, measured)
        odds = odds_of_objects(self.follower.weights["objectness"], description)
        columns = {name: description[:, k] for k, name in enumerate(DETECTION)}
        frame = Frame(
            np.arange(len(box)), box, odds, columns["overlap"], columns["neighbours"], category
        )
        identity, link = self.follower.step(self.count, frame, step, measured)
        rank, meaning = measured.rank(score), measured.means(score)
        for k, number in enumerate(identity.tolist()):
            if number >= 0 and number not in self.shown:
                told = [self.count, odds[k], columns["overlap_stronger"][k], link[k], rank[k],
                        meaning[k], columns["overlap"][k], columns["neighbours"][k]]  # fmt: skip
                self.evidence.setdefault(number, []).append(told)
        self._judge(identity)
        return identity

    def _judge(self, identity: np.ndarray) -> None:
        """Show the tracks of this frame whose boxes together say that they are objects."""
        waiting = [number for number in identity.tolist() if number in self.evidence]
        if waiting:
            rows = [np.array(self.evidence[number]) for number in waiting]
            label = np.repeat(np.arange(len(rows)), [len(part) for part in rows])
            columns = np.concatenate(rows).T
            frame, *rest = columns
            features = track_features(Boxes(label, frame.astype(np.int64), *rest))
            judged = self.follower.weights["tracks"](features)
            for number in np.array(waiting)[judged > self.object_odds].tolist():
                self.shown[number] = len(self.shown) + 1
                del self.evidence[number]
        alive = set(self.follower.states.identity.tolist())
        self.evidence = {k: v for k, v in self.evidence.items() if k in alive}

    def _told(self, detections: Any, row: np.ndarray, identity: np.ndarray) -> Any:
        found = detections[row]
        found.tracker_id = identity
        return found
