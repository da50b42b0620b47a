"""Offline tracking: association of boxes, and of the tracklets that they make, again and again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from mixer_torch.association import Association, by_first_appearance
from mixer_torch.fusion import Fusion, LogOddsFusion
from mixer_torch.observations import Observations
from mixer_torch.pairs import PairSelector, Reachable, within_view
from mixer_torch.scoring import Progress, Scorer, score
from mixer_torch.solvers.base import solve
from mixer_torch.solvers.mixer import Mixer
from mixer_torch.solvers.problem import Solver
from mixer_torch.tracking.appearance import looks, with_looks
from mixer_torch.tracking.base import BaseTracker
from mixer_torch.tracking.camera_motion import CameraMotion
from mixer_torch.tracking.camera_path import CameraPath
from mixer_torch.tracking.causal import causal_labels
from mixer_torch.tracking.motion import MotionModel
from mixer_torch.tracking.postprocessing import interpolated, smoothed, strong
from mixer_torch.tracking.tracklets import (
    measured_resolution,
    overlapping,
    successive,
    summarised,
    with_paths,
)
from mixer_torch.tracks import Tracks

NEAR: dict[str, Any] = {
    "window": 0.3,
    "reach": 1.0,
    "speed": 2.0,
    "growth": 0.7,
    "views": 3,
    "most_views": 6,
}
"""Arguments of :class:`Reachable` for level one: long gaps are left to level two."""
NOT_NEGATIVE = (
    "patience",
    "reach",
    "speed",
    "growth",
    "memory",
    "tracklet_memory",
    "inflation",
    "tracklet_inflation",
    "min_strength",
    "fill",
    "smoothing",
)


class Tracker(BaseTracker):
    """Who is who in a sequence, at full length: boxes are associated, then the tracklets they make.

    A causal pass through the frames, forwards and then backwards in time, gives the first labels.
    Level one scores pairs of boxes that one object could have made, with velocities fitted on the
    labels so far as if each cluster were cut at the box in question, and solves; this is repeated
    with the labels found, ``passes`` times in all. Level two takes the clusters as observations
    and does the same with their ends and mean looks, over the gaps in turn; tracklets that overlap
    in time are never joined.

    The defaults are fitted to people on foot, see ``configs/track.yaml``.

    Args:
        scorers: How boxes are compared, one for each modality.
        tracklet_scorers: How tracklets are compared, by the features that
            :func:`~mixer_torch.tracking.tracklets.summarised` gives them.
        appearance: Scorers of looks for both levels, where there are pixels or features: they
            describe each box once, as one tensor of floats, and tracklets have the mean of it.
        pairs: Which boxes to compare; those of :data:`NEAR` if None.
        fusion: How modalities add up; log odds if None.
        solver: The algorithm of both levels; ``Mixer`` with few restarts if None.
        model: How things move, for the velocities; people walking if None.
        camera_motion: How the motion of the camera is seen in the pixels, to be taken out: boxes
            are associated, interpolated and smoothed where they would be had it rested. If None,
            it is taken to rest.
        patience: Longest time that the causal pass waits for a path to be seen again, seconds;
            0 to begin without labels, and so without velocities.
        passes: Solutions of level one.
        gaps: Longest time between two tracklets, seconds, one for each solution of level two.
        reach: What detections of one thing differ by at most, heights (level two).
        speed: Greatest speed, heights a second (level two).
        growth: Greatest difference of size, nats (level two).
        memory: How many boxes before and after velocities are fitted on, at level one.
        tracklet_memory: The same at level two.
        inflation: By how much the detector's error is taken to be larger than measured, at level
            one, as errors of successive boxes are alike.
        tracklet_inflation: The same at level two: tracklets end where boxes are at their worst.
        min_boxes: Tracks of fewer boxes are dropped.
        min_confidence: Tracks of a lower typical confidence are dropped, see
            :func:`~mixer_torch.tracking.postprocessing.strong`.
        min_strength: Tracks of a lower sum of confidences are dropped.
        fill: Gaps up to this long are filled with boxes in between, seconds; 0 for none.
        smoothing: Standard deviation of the average over time that boxes are replaced by,
            seconds; 0 leaves them as detected.

    Raises:
        ValueError: An argument is out of range.
    """

    def __init__(
        self,
        scorers: list[Scorer],
        tracklet_scorers: list[Scorer],
        appearance: list[Scorer] | None = None,
        pairs: PairSelector | None = None,
        fusion: Fusion | None = None,
        solver: Solver | None = None,
        model: MotionModel | None = None,
        camera_motion: CameraMotion | None = None,
        patience: float = 0.5,
        passes: int = 2,
        gaps: Sequence[float] = (0.5, 1.0, 2.0, 4.0),
        reach: float = 1.0,
        speed: float = 2.0,
        growth: float = 0.7,
        memory: int = 12,
        tracklet_memory: int = 30,
        inflation: float = 1.5,
        tracklet_inflation: float = 5.0,
        min_boxes: int = 3,
        min_confidence: float = 0.94,
        min_strength: float = 10.0,
        fill: float = 2.0,
        smoothing: float = 0.3,
    ) -> None:
        if not scorers:
            raise ValueError("scorers: expected at least one, got none")
        if gaps and not tracklet_scorers:
            raise ValueError("tracklet_scorers: expected at least one, or no gaps")
        if passes < 1:
            raise ValueError(f"passes: expected 1 or more, got {passes}")
        self.scorers = list(scorers)
        self.tracklet_scorers = list(tracklet_scorers)
        self.appearance = list(appearance or [])
        self.pairs = pairs or Reachable(**NEAR)
        self.fusion = fusion or LogOddsFusion(cap=8.0)
        self.solver = solver or Mixer(restarts=10)
        self.model = model or MotionModel()
        self.camera_motion = camera_motion
        self.patience = patience
        self.passes = passes
        self.gaps = tuple(gaps)
        self.reach, self.speed, self.growth = reach, speed, growth
        self.memory, self.tracklet_memory = memory, tracklet_memory
        self.inflation, self.tracklet_inflation = inflation, tracklet_inflation
        self.min_boxes = min_boxes
        self.min_confidence = min_confidence
        self.min_strength = min_strength
        self.fill = fill
        self.smoothing = smoothing
        for name in NOT_NEGATIVE:
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: expected 0 or more, got {getattr(self, name)}")
        if not all(gap > 0 for gap in self.gaps):
            raise ValueError(f"gaps: expected positive numbers, got {self.gaps}")

    def associate(
        self, observations: Observations, progress: Progress | None = None
    ) -> Association:
        """A label for every observation, weak ones and clutter included.

        The objective is that of the last solution of level one. ``stats`` tells how many
        tracklets it left, how many clusters there are in the end, and the ``camera_path`` that
        was taken out, where one was.
        """
        check(observations)
        observations = with_looks(observations, self.appearance)
        stats: dict[str, Any] = {}
        if self.camera_motion is not None:
            stats["camera_path"] = path = self.camera_motion.path(observations, progress)
            observations = path.stabilised(observations)
        labels = self.begin(observations)
        pairs = self.pairs(observations)
        for _ in range(self.passes):
            answer = self.link(observations, labels, pairs, progress=progress)
            labels = _labels(answer)
        tracklets = answer.num_clusters
        for gap in self.gaps:
            labels = self.join(observations, labels, gap, progress=progress)
        count = int(labels.max()) + 1 if len(labels) else 0
        stats |= {**answer.stats, "tracklets": tracklets, "clusters": count}
        return Association(labels, answer.objective, answer.status, stats=stats)

    def begin(self, observations: Observations) -> Int64[Tensor, " m"]:
        """Labels of a causal pass forwards, then of one backwards that knows the errors better."""
        labels = torch.arange(len(observations), device=observations.device)
        if self.patience == 0:
            return labels
        for backwards in (False, True):
            error = self.inflation * measured_resolution(observations, labels, self.model)
            labels = causal_labels(
                observations, self.model, error, patience=self.patience, backwards=backwards
            )
        return by_first_appearance(labels)

    def link(
        self,
        observations: Observations,
        labels: Int64[Tensor, " m"],
        pairs: Int64[Tensor, "2 P"],
        must_link: Int64[Tensor, "2 K"] | None = None,
        progress: Progress | None = None,
    ) -> Association:
        """Level one, once: who is who among boxes, with velocities fitted on the labels so far.

        Args:
            observations: The sequence, or a stretch of it.
            labels: Clusters of links that are confident.
            pairs: Which boxes to compare.
            must_link: Pairs of boxes that are known to be of one object.
            progress: Told what is done while it goes on.
        """
        known = with_paths(observations, labels, self.model, self.memory, self.inflation)
        known = with_looks(known, self.appearance)
        affinity = score(known, [*self.scorers, *looks(self.appearance)], pairs, progress)
        return solve(affinity, self.solver, self.fusion, must_link=must_link)

    def tracklets(self, observations: Observations, labels: Int64[Tensor, " m"]) -> Observations:
        """The clusters 0.. as observations of their own
        (:func:`~mixer_torch.tracking.tracklets.summarised`).
        """
        known = with_paths(
            observations, labels, self.model, self.tracklet_memory, self.tracklet_inflation
        )
        return summarised(with_looks(known, self.appearance), labels)

    def join(
        self,
        observations: Observations,
        labels: Int64[Tensor, " m"],
        gap: float,
        settled: Bool[Tensor, " k"] | None = None,
        progress: Progress | None = None,
    ) -> Int64[Tensor, " m"]:
        """Level two, once: the labels when tracklets are joined over gaps of so many seconds.

        Args:
            observations: The sequence, or a stretch of it.
            labels: The tracklets, 0.., each used.
            gap: Longest time between two.
            settled: Which tracklets are known to be of different objects, each of its own.
            progress: Told what is done while it goes on.
        """
        tracklets = self.tracklets(observations, labels)
        pairs = successive(tracklets, gap, self.reach, self.speed, self.growth)
        if settled is not None:
            tracklets = replace(tracklets, view=torch.where(settled, 0, -1))
            pairs = pairs[:, ~within_view(tracklets.view, pairs)]
        scorers = [*self.tracklet_scorers, *looks(self.appearance)]
        affinity = score(tracklets, scorers, pairs, progress)
        apart = overlapping(tracklets["span"], tracklets.features.get("camera"))
        joined = solve(affinity, self.solver, self.fusion, cannot_link=apart)
        return by_first_appearance(_labels(joined)[labels])

    def finish(self, observations: Observations, association: Association) -> Tracks:
        """The tracks of objects: weak ones dropped, short gaps filled, boxes smoothed.

        Where the camera's motion is taken out, that is done where boxes rest, on the
        ``camera_path`` of the association's ``stats`` or on one that is found anew.
        """
        tracks = Tracks.from_labels(observations, _labels(association))
        seconds = seconds_per_frame(observations)
        if self.camera_motion is None:
            return self.end(tracks, seconds)
        path = association.stats.get("camera_path")
        if not isinstance(path, CameraPath):
            path = self.camera_motion.path(observations)
        return path.restored(self.end(path.steadied(tracks), seconds))

    def end(self, tracks: Tracks, seconds: float) -> Tracks:
        """Drop the weak, fill gaps and smooth, with so many seconds from frame to frame."""
        keep = strong(tracks, self.min_boxes, self.min_confidence, self.min_strength)
        filled = interpolated(tracks.select(keep), self.fill / seconds)
        return smoothed(filled, self.smoothing / seconds)


def _labels(association: Association) -> Int64[Tensor, " m"]:
    if association.labels is None:
        raise ValueError("solver: expected one that always gives labels")
    return association.labels


def check(observations: Observations) -> None:
    """KeyError or ValueError unless boxes and times are there and finite."""
    for key in ("box", "time"):
        if not bool(observations[key].isfinite().all()):
            row = int((~observations[key].isfinite()).nonzero()[0, 0])
            raise ValueError(f"{key}: expected finite numbers, got {observations[key][row]}")


def seconds_per_frame(observations: Observations) -> float:
    """The time from one frame to the next; 1 where all is of one frame."""
    frame, time = observations["frame"].double(), observations["time"]
    if not len(frame) or float(frame.max() - frame.min()) == 0:
        return 1.0
    return float((time.max() - time.min()) / (frame.max() - frame.min()))
