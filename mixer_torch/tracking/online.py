"""Online tracking: the problem of the last moments, posed anew with each frame."""

from __future__ import annotations

import copy
import math
import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from mixer_torch.association import Association, Status, by_first_appearance
from mixer_torch.observations import Images, Observations
from mixer_torch.scoring import Progress
from mixer_torch.tracking.appearance import with_looks
from mixer_torch.tracking.base import BaseTracker
from mixer_torch.tracking.tracker import Tracker, check
from mixer_torch.tracks import Tracks


@dataclass(frozen=True)
class Update:
    """What is said now of the observations that were not settled before.

    Args:
        observation: (n,) which ones, ascending, counted from 0 in the order in which they came.
        label: (n,) the object of each, 0 or more. Identities of tracks are label + 1.
        settled: (n,) whether that is the last word.
        latency: Seconds of work for each frame that came, in order of time.
    """

    observation: Int64[Tensor, " n"]
    label: Int64[Tensor, " n"]
    settled: Bool[Tensor, " n"]
    latency: tuple[float, ...]


class OnlineTracker(BaseTracker):
    """Tracks while frames arrive: only what was said of the last moments may be revised.

    With each frame, the problem of an offline :class:`~mixer_torch.tracking.tracker.Tracker` is
    posed and solved for a bounded set of observations. Those of the last ``window`` seconds are
    free. Older ones are settled: their labels are never changed. Of these, the last few of each
    object that was seen not too long ago take part, known to be the same (must-link) and known to
    differ from those of other objects (one common view); so an object goes on where it was left,
    at both levels, and the work for a frame does not depend on how many came before it.

    A cluster that holds settled observations has their label. Any other one has the label that
    most of its observations were last said to have, if no other cluster has more of these, and a
    new one if there is none. :meth:`finish` is that of the offline tracker.

    Where a scorer reads pixels, the frames of the bounded set are held in memory, and what is in
    them is described anew with each frame.

    Args:
        tracker: How boxes and tracklets are compared and clustered, and how tracks end.
        window: Seconds for which what is said of an observation may be revised.
        passes: Solutions of level one for each frame. Velocities are fitted on the tracklets of
            the frame before, so one is enough.
        memory: Settled observations that are kept of each object.
        recall: Seconds for which an object is kept after it was last seen, beyond the window; if
            None, as long as the longest gap that the tracker bridges.

    Raises:
        ValueError: An argument is out of range.
    """

    def __init__(
        self,
        tracker: Tracker,
        window: float = 3.0,
        passes: int = 1,
        memory: int = 30,
        recall: float | None = None,
    ) -> None:
        if not 0 <= window < math.inf:
            raise ValueError(f"window: expected a finite number of 0 or more, got {window}")
        for name, count in (("passes", passes), ("memory", memory)):
            if count < 1:
                raise ValueError(f"{name}: expected 1 or more, got {count}")
        if tracker.camera_motion is not None:
            raise ValueError("tracker: camera_motion is for whole sequences; expected none online")
        if recall is not None and not recall >= 0:
            raise ValueError(f"recall: expected a number of 0 or more, got {recall}")
        self.tracker = tracker
        self.window = window
        self.passes = passes
        self.memory = memory
        self.recall = max([0.0, *tracker.gaps]) if recall is None else recall
        self._stretch: Stretch | None = None

    def reset(self) -> None:
        """Forget all that came: what comes next is another sequence."""
        self._stretch = None

    def update(self, observations: Observations) -> Update:
        """Take what was seen in the next frame, or in several frames.

        Frames are told apart by ``time`` and taken one after the other, so that it makes no
        difference in which chunks they come. No observations, no frame: nothing changes.

        Args:
            observations: In any order, all of them later than those that came before.

        Raises:
            KeyError: There is no feature ``time`` or ``box``.
            ValueError: Observations are not later than those that came before, or have a box or a
                time that is not finite.
        """
        if not self._reads_pixels():
            observations = replace(observations, images=None)
        check(observations)
        stretch = self._stretch or Stretch.empty(observations)
        moments = _moments(observations, stretch)
        number = stretch.came + torch.arange(len(observations), device=observations.device)
        said = [stretch.said(~stretch.settled)]
        latency = []
        for moment in moments:
            start = time.perf_counter()
            here = observations["time"] == moment
            free, stretch = ~stretch.settled, self._settled(stretch, float(moment))
            said.append(stretch.said(free))
            stretch = self._bounded(stretch, float(moment))
            stretch = stretch.extended(observations.select(here), number[here])
            free, stretch = ~stretch.settled, self._settled(self._solved(stretch), float(moment))
            said.append(stretch.said(free))
            latency.append(time.perf_counter() - start)
        self._stretch = replace(stretch, came=stretch.came + len(observations))
        observation, label, settled = _last_words(torch.cat(said, 1))
        return Update(observation, label, settled.bool(), tuple(latency))

    def associate(
        self, observations: Observations, progress: Progress | None = None
    ) -> Association:
        """The labels that a sequence has in the end when it arrives frame by frame.

        What :meth:`update` was given before is neither used nor forgotten. There is no one problem
        that is solved, so the objective is NaN; ``stats`` tells ``latency``, seconds for each
        frame in order of time.
        """
        online = copy.copy(self)
        online.reset()
        labels = torch.full_like(observations.view, -1)
        order = torch.argsort(observations["time"], stable=True)
        moments, size = torch.unique_consecutive(observations["time"][order], return_counts=True)
        latency: list[float] = []
        for k, rows in enumerate(order.split(size.tolist())):
            update = online.update(observations.select(rows))
            labels[order[update.observation]] = update.label
            latency += update.latency
            if progress is not None:
                progress("frames", k + 1, len(moments))
        return Association(
            by_first_appearance(labels), math.nan, Status.CONVERGED, stats={"latency": latency}
        )

    def finish(self, observations: Observations, association: Association) -> Tracks:
        return self.tracker.finish(observations, association)

    def to(self, device: torch.device | str) -> OnlineTracker:
        self.tracker.to(device)
        return self

    def _reads_pixels(self) -> bool:
        tracker = self.tracker
        scorers = [*tracker.scorers, *tracker.tracklet_scorers, *tracker.appearance]
        return any("images" in scorer.needs for scorer in scorers)

    def _solved(self, stretch: Stretch) -> Stretch:
        """The stretch with labels that fit all of it best."""
        seen, said = with_looks(stretch.observations, self.tracker.appearance), stretch.label
        known = torch.where(stretch.settled, said, -1)
        pairs = self.tracker.pairs(seen)
        pairs = pairs[:, ~stretch.settled[pairs].all(0)]
        must_link, distinct = _settled_links(seen, known)
        before = stretch.tracklet
        fresh = before.max() + 1 + torch.arange(len(seen), device=said.device)
        label = by_first_appearance(torch.where(before >= 0, before, fresh))
        for _ in range(self.passes):
            linked = self.tracker.link(distinct, label, pairs, must_link).labels
            if linked is None:
                raise ValueError("tracker.solver: expected one that always gives labels")
            label = linked
        tracklet = label
        for gap in self.tracker.gaps:
            label = self.tracker.join(seen, label, gap, _largest(known, label) >= 0)
        name, following = _names(label, known, said, stretch.next)
        return replace(stretch, tracklet=tracklet, label=name[label], next=following)

    def _settled(self, stretch: Stretch, now: float) -> Stretch:
        old = stretch.observations["time"] <= now - self.window
        return replace(stretch, settled=stretch.settled | old)

    def _bounded(self, stretch: Stretch, now: float) -> Stretch:
        """The stretch without what has no say any more."""
        moment = stretch.observations["time"]
        last = torch.full((stretch.next,), -math.inf, dtype=moment.dtype, device=moment.device)
        last = last.scatter_reduce(0, stretch.label, moment, "amax")
        recent = (last >= now - self.window - self.recall)[stretch.label]
        rank = _rank_from_last(stretch.label, moment, stretch.settled)
        return stretch.select(~stretch.settled | (recent & (rank < self.memory)))


@dataclass(frozen=True)
class Stretch:
    """The observations that have a say, and what was last said of them.

    Args:
        observations: Free and settled ones.
        number: (n,) which they are, in the order in which all came.
        tracklet: (n,) the cluster of each at level one, on which velocities are fitted with the
            next frame; -1 where there is none yet.
        label: (n,) the object of each, -1 where nothing was said yet.
        settled: (n,) whether that stays.
        came: How many observations came in all.
        next: The next new label.
        latest: The time of the last frame.
    """

    observations: Observations
    number: Int64[Tensor, " n"]
    tracklet: Int64[Tensor, " n"]
    label: Int64[Tensor, " n"]
    settled: Bool[Tensor, " n"]
    came: int
    next: int
    latest: float

    @classmethod
    def empty(cls, like: Observations) -> Stretch:
        """Of nothing yet, with the features and on the device of some observations."""
        none = like.view.new_zeros(0)
        return cls(like.select(none), none, none, none, none.bool(), 0, 0, -math.inf)

    def extended(self, new: Observations, number: Int64[Tensor, " k"]) -> Stretch:
        """With the observations of another frame."""
        if set(new.features) != set(self.observations.features):
            raise ValueError(
                f"observations: expected features {', '.join(self.observations.features)}, as "
                f"before, got {', '.join(new.features)}"
            )
        features = {
            name: torch.cat([value, new[name]])
            for name, value in self.observations.features.items()
        }
        images = _held(self.observations.images, new.images)
        seen = Observations(torch.cat([self.observations.view, new.view]), features, images)
        return replace(
            self,
            observations=seen,
            number=torch.cat([self.number, number]),
            tracklet=torch.cat([self.tracklet, torch.full_like(number, -1)]),
            label=torch.cat([self.label, torch.full_like(number, -1)]),
            settled=torch.cat([self.settled, torch.zeros_like(number, dtype=torch.bool)]),
            latest=float(new["time"].max()),
        )

    def select(self, mask: Bool[Tensor, " n"]) -> Stretch:
        """Some of the observations."""
        return replace(
            self,
            observations=self.observations.select(mask),
            number=self.number[mask],
            tracklet=self.tracklet[mask],
            label=self.label[mask],
            settled=self.settled[mask],
        )

    def said(self, mask: Bool[Tensor, " n"]) -> Int64[Tensor, "3 k"]:
        """Number, label and whether it is settled, of some of the observations."""
        return torch.stack([self.number, self.label, self.settled.long()])[:, mask]


def _held(before: Images | None, new: Images | None) -> Images | None:
    """The pixels of both, in memory: each frame that is of use, once."""
    if before is None or new is None:
        return None
    frames: list[np.ndarray] = []
    place = []
    for images in (before, new):
        used, index = np.unique(images.frame_index, return_inverse=True)
        place.append(index + len(frames))
        frames += [images.frames[k] for k in used]
    boxes = [images.box for images in (before, new) if images.box is not None]
    return Images(frames, np.concatenate(place), np.concatenate(boxes) if boxes else None)


def _moments(observations: Observations, stretch: Stretch) -> Float[Tensor, " f"]:
    """The times of the frames, or a ValueError where they do not follow what came before."""
    moments = torch.unique(observations["time"])
    if len(moments) and float(moments[0]) <= stretch.latest:
        raise ValueError(
            f"observations: expected frames in order of time, after {stretch.latest:g} s, "
            f"got one of {float(moments[0]):g} s"
        )
    return moments


def _settled_links(
    seen: Observations, known: Int64[Tensor, " n"]
) -> tuple[Int64[Tensor, "2 K"], Observations]:
    """Pairs that chain what is settled to be one object, and views that keep the objects apart.

    The last settled observation of each object is put into one further view, as objects are
    distinct within a view. It keeps its place in its chain, and leaves nobody in its old view who
    could be taken for the object: whoever is of a settled frame is settled, too.

    Args:
        seen: The observations.
        known: The label of those that are settled, -1 for others.
    """
    order = torch.argsort(seen["time"], stable=True)
    order = order[torch.argsort(known[order], stable=True)]
    order = order[known[order] >= 0]
    same = known[order[1:]] == known[order[:-1]]
    last = order[torch.cat([~same, same.new_ones(min(len(order), 1))])]
    view = seen.view.clone()
    view[last] = view.max() + 1 if len(view) else 0
    return torch.stack([order[:-1][same], order[1:][same]]), replace(seen, view=view)


def _largest(value: Int64[Tensor, " n"], label: Int64[Tensor, " n"]) -> Int64[Tensor, " k"]:
    """The largest value in each cluster, of labels 0.., each used."""
    most = torch.full((int(label.max()) + 1,), -1, dtype=value.dtype, device=value.device)
    return most.scatter_reduce(0, label, value, "amax")


def _names(
    label: Int64[Tensor, " n"],
    known: Int64[Tensor, " n"],
    said: Int64[Tensor, " n"],
    following: int,
) -> tuple[Int64[Tensor, " k"], int]:
    """Which object each cluster is, and the next label that is free.

    Args:
        label: Clusters 0.., each used.
        known: The object of settled observations, -1 for others.
        said: The object that was last named, -1 where there was none.
        following: The next new name.
    """
    name = _largest(known, label)
    taken = set(name[name >= 0].tolist())
    both = torch.stack([label, said])[:, (name[label] < 0) & (said >= 0)]
    votes, count = torch.unique(both, dim=1, return_counts=True)
    for k in torch.argsort(-count, stable=True).tolist():
        cluster, old = votes[:, k].tolist()
        if old not in taken and name[cluster] < 0:
            name[cluster] = old
            taken.add(old)
    new = name < 0
    name[new] = following + torch.arange(int(new.sum()), device=name.device)
    return name, following + int(new.sum())


def _rank_from_last(
    label: Int64[Tensor, " n"], moment: Float[Tensor, " n"], settled: Bool[Tensor, " n"]
) -> Int64[Tensor, " n"]:
    """How many later settled observations of the same label there are."""
    order = torch.argsort(moment, descending=True, stable=True)
    order = order[torch.argsort(label[order], stable=True)]
    count = torch.cumsum(settled[order], 0) - settled[order].long()
    first = torch.cat([label.new_ones(1).bool(), label[order[1:]] != label[order[:-1]]])
    start = torch.where(first[: len(order)], count, 0)
    rank = torch.empty_like(label)
    rank[order] = count - torch.cummax(start, 0).values
    return rank


def _last_words(
    said: Int64[Tensor, "3 n"],
) -> tuple[Int64[Tensor, " k"], Int64[Tensor, " k"], Int64[Tensor, " k"]]:
    """The last column of each number, in order of numbers."""
    number, which = torch.unique(said[0], return_inverse=True)
    place = torch.arange(said.shape[1], device=said.device)
    last = torch.zeros_like(number).scatter_reduce(0, which, place, "amax", include_self=False)
    return number, said[1, last], said[2, last]
