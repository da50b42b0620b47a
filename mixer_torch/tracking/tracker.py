"""Offline tracking: association of boxes, and of the tracklets that they make, again and again."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from mixer_torch.association import Association, by_first_appearance
from mixer_torch.fusion import Fusion, LogOddsFusion
from mixer_torch.observations import Observations
from mixer_torch.pairs import PairSelector, Reachable, within_view
from mixer_torch.scoring import Progress, Scorer, score
from mixer_torch.solvers.base import Solver, solve
from mixer_torch.solvers.mixer import Mixer
from mixer_torch.tracking.base import BaseTracker
from mixer_torch.tracking.ending import interpolated, smoothed, strong
from mixer_torch.tracking.motion import MotionModel
from mixer_torch.tracking.tracklets import overlapping, successive, summarised, with_paths
from mixer_torch.tracking.tracks import Tracks


class Tracker(BaseTracker):
    """Who is who in a sequence, at full length: boxes are associated, then the tracklets they make.

    Level one scores pairs of boxes that one object could have made, and solves. Velocities are
    then fitted on the links found, as if each cluster were cut at the box in question, and the
    same pairs are scored and solved again with them, ``passes`` times in all. Level two takes the
    clusters as observations and does the same with their ends, over the gaps in turn; tracklets
    that overlap in time are never joined.

    Args:
        scorers: How boxes are compared, one for each modality.
        tracklet_scorers: How tracklets are compared.
        pairs: Which boxes to compare; ``Reachable()`` if None.
        fusion: How modalities add up; log odds if None.
        solver: The algorithm of both levels; ``Mixer`` with few restarts if None.
        model: How things move, for the velocities; people walking if None.
        passes: Solutions of level one.
        gaps: Longest time between two tracklets, seconds, one for each solution of level two.
        reach: What detections of one thing differ by at most, heights (level two).
        speed: Greatest speed, heights a second (level two).
        growth: Greatest difference of size, nats (level two).
        memory: How many boxes before and after velocities are fitted on.
        min_boxes: Tracks of fewer boxes are dropped.
        min_confidence: Tracks of a lower mean confidence are dropped.
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
        pairs: PairSelector | None = None,
        fusion: Fusion | None = None,
        solver: Solver | None = None,
        model: MotionModel | None = None,
        passes: int = 3,
        gaps: list[float] = [0.5, 1.0, 2.0],  # noqa: B006
        reach: float = 0.5,
        speed: float = 2.0,
        growth: float = 0.7,
        memory: int = 12,
        min_boxes: int = 3,
        min_confidence: float = 0.9,
        min_strength: float = 5.0,
        fill: float = 1.0,
        smoothing: float = 0.2,
        scale: float = 1.0,
        scale2: float = 5.0,
        memory2: int = 30,
    ) -> None:
        self.scorers = list(scorers)
        self.tracklet_scorers = list(tracklet_scorers)
        self.pairs = pairs or Reachable()
        self.fusion = fusion or LogOddsFusion(cap=8.0)
        self.solver = solver or Mixer(restarts=10)
        self.model = model or MotionModel()
        self.passes = passes
        self.gaps = tuple(gaps)
        self.reach, self.speed, self.growth = reach, speed, growth
        self.memory = memory
        self.scale = scale
        self.scale2, self.memory2 = scale2, memory2
        self.min_boxes = min_boxes
        self.min_confidence = min_confidence
        self.min_strength = min_strength
        self.fill = fill
        self.smoothing = smoothing

    def associate(
        self, observations: Observations, progress: Progress | None = None
    ) -> Association:
        """A label for every observation, weak ones and clutter included."""
        labels = torch.arange(len(observations), device=observations.device)
        pairs = self.pairs(observations)
        for _ in range(self.passes):
            answer = self.link(observations, labels, pairs, progress=progress)
            labels = answer.labels
        for gap in self.gaps:
            labels = self.join(observations, labels, gap, progress=progress)
        return Association(labels, answer.objective, answer.status, None, dict(answer.stats))

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
        known = with_paths(observations, labels, self.model, self.memory, self.scale)
        affinity = score(known, self.scorers, pairs, progress)
        return solve(affinity, self.solver, self.fusion, must_link=must_link)

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
        known = with_paths(observations, labels, self.model, self.memory2, self.scale2)
        tracklets = summarised(known, labels)
        pairs = successive(tracklets, gap, self.reach, self.speed, self.growth)
        if settled is not None:
            tracklets = replace(tracklets, view=torch.where(settled, 0, -1))
            pairs = pairs[:, ~within_view(tracklets.view, pairs)]
        affinity = score(tracklets, self.tracklet_scorers, pairs, progress)
        apart = overlapping(tracklets["span"], tracklets.features.get("camera"))
        joined = solve(affinity, self.solver, self.fusion, cannot_link=apart)
        return by_first_appearance(joined.labels[labels])

    def finish(self, observations: Observations, association: Association) -> Tracks:
        """The tracks of objects: weak ones dropped, short gaps filled, boxes smoothed."""
        tracks = Tracks.from_labels(observations, association.labels)
        return self.end(tracks, seconds_per_frame(observations))

    def end(self, tracks: Tracks, seconds: float) -> Tracks:
        """Drop the weak, fill gaps and smooth, with so many seconds from frame to frame."""
        keep = strong(tracks, self.min_boxes, self.min_confidence, self.min_strength)
        filled = interpolated(tracks.select(keep), self.fill / seconds)
        return smoothed(filled, self.smoothing / seconds)


def seconds_per_frame(observations: Observations) -> float:
    """The time from one frame to the next; 1 where all is of one frame."""
    frame, time = observations["frame"].double(), observations["time"]
    if not len(frame) or float(frame.max() - frame.min()) == 0:
        return 1.0
    return float((time.max() - time.min()) / (frame.max() - frame.min()))
