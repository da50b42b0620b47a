"""The tracker: detections of a sequence in, who was where out."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence as Listed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mixer_torch.association import Association, Status, by_first_appearance
from mixer_torch.observations import Observations
from mixer_torch.scoring import Progress, Scorer
from mixer_torch.tracking.appearance import ScorerEvidence
from mixer_torch.tracking.base import BaseTracker
from mixer_torch.tracking.camera_motion import CameraMotion
from mixer_torch.tracking.camera_path import CameraPath, frames_and_cameras, path_of_steps, steps_of
from mixer_torch.tracking.evidence import FEATURES
from mixer_torch.tracking.following import DETECTION, Follower, Linking
from mixer_torch.tracking.joining import JOIN, Joining, joined
from mixer_torch.tracking.measured import Measured, Sequence
from mixer_torch.tracking.objects import TRACK, Boxes, numbered, track_features
from mixer_torch.tracking.passes import follow_online, follow_whole
from mixer_torch.tracking.postprocessing import (
    PostProcessing,
    bandwidth,
    interpolated,
    smoothed,
)
from mixer_torch.tracking.stream import Stream
from mixer_torch.tracking.weights import Weights
from mixer_torch.tracks import Tracks

INPUTS = {"objectness": DETECTION, "evidence": FEATURES, "joins": JOIN, "tracks": TRACK}
"""What the networks of the weights have to be learned on."""
MANY_DROPPED = 0.5
"""Share of the detections that are probably objects, from which dropping them is worth a word."""


@dataclass(frozen=True)
class Followed:
    """What a tracker found out about the detections of one camera.

    Args:
        rows: (n,) the observations, in order of frames.
        sequence: The detections.
        measured: What was measured of them.
        boxes: What is known of each detection; ``boxes.label`` has the tracks, 0.., -1 for none.
        objects: (k,) log odds that each track is an object.
    """

    rows: np.ndarray
    sequence: Sequence
    measured: Measured
    boxes: Boxes
    objects: np.ndarray


class Tracker(BaseTracker):
    """Who is who among the detections of a sequence, of anything in boxes, by any detector.

    What depends on the data is measured on the sequence, without labels: what scores mean, how far
    boxes jitter and move, and how the camera moves (a :class:`Measured` of each camera, in the
    association's ``stats["measured"]``: print it). Frame by frame, modalities (overlap,
    motion, edges, shape, score, and the ratio to the best rival) each give a calibrated log
    likelihood ratio for every pair of a track and a detection; their sum is assigned one to one.
    Offline, the tracks may then be joined over longer gaps, all at once, by MIXER (``joining``). A
    track is an object where its boxes together say so.

    Args:
        linking: How detections are put on tracks.
        joining: How tracks are joined over gaps, which is done offline alone; by default they are
            not.
        post: What is done to the tracks of objects.
        online: Decide frame by frame: what was said of a frame never changes.
        camera: How the camera moves: None to see it in the boxes, a :class:`CameraMotion` to see it
            in the pixels, or a :class:`CameraPath` or the name of a file of matrices
            (:meth:`CameraPath.load`) where it is known.
        scorers: Further modalities, for what observations have beside boxes (images, positions,
            embeddings): each scores a detection against the latest box of a track.
        weights: What was learned: a file, or what is shipped if None.
        across_categories: Whether a track may be of several categories.
        frame_rate: Frames a second, for :meth:`update` and observations without ``time``.

    Raises:
        ValueError: A setting is out of range, or weights are not readable.
    """

    def __init__(
        self,
        linking: Linking | None = None,
        joining: Joining | None = None,
        post: PostProcessing | None = None,
        online: bool = False,
        camera: CameraMotion | CameraPath | str | Path | None = None,
        scorers: Listed[Scorer] = (),
        weights: Weights | str | Path | None = None,
        across_categories: bool = False,
        frame_rate: float | None = None,
    ) -> None:
        if frame_rate is not None and not (np.isfinite(frame_rate) and frame_rate > 0):
            raise ValueError(f"frame_rate: expected a positive number, got {frame_rate}")
        self.linking = linking or Linking()
        self.joining = joining or Joining()
        self.post = post or PostProcessing()
        self.online = online
        self.camera = CameraPath.load(camera) if isinstance(camera, str | Path) else camera
        self.scorers = list(scorers)
        if weights is None:
            weights = Weights.shipped()
        self.weights = weights if isinstance(weights, Weights) else Weights.load(weights)
        self.weights.check(INPUTS)
        self.across_categories = across_categories
        self.frame_rate = frame_rate
        self._stream: Stream | None = None

    def associate(
        self, observations: Observations, progress: Progress | None = None
    ) -> Association:
        """A label for every observation, clutter included; one on no track has a label of its own.

        ``stats`` has, by camera, what was ``measured``, and with ``online`` the ``latency`` of each
        frame, seconds. The objective is the sum of the evidence for the links, negative.
        """
        started = time.perf_counter()
        rate = self._frame_rate(observations)
        frame, camera = frames_and_cameras(observations)
        good = self._usable(observations)
        labels = np.full(len(observations), -1)
        followed: dict[int, Followed] = {}
        latency: list[float] = []
        for number in np.unique(camera[good]).tolist():
            rows = np.flatnonzero(good & (camera == number))
            rows = rows[np.argsort(frame[rows], kind="stable")]
            found = self._follow(observations, rows, number, rate, latency, progress)
            followed[number] = found
            on_track = found.boxes.label >= 0
            labels[rows[on_track]] = found.boxes.label[on_track] + labels.max(initial=-1) + 1
        alone = labels < 0
        labels[alone] = labels.max(initial=-1) + 1 + np.arange(alone.sum())
        stats = {
            "measured": {number: one.measured for number, one in followed.items()},
            "followed": followed,
            "seconds": time.perf_counter() - started,
        }
        if self.online:
            stats["latency"] = latency
        evidence = sum(float(one.boxes.link.sum()) for one in followed.values())
        label = by_first_appearance(torch.from_numpy(labels)).to(observations.device)
        return Association(label, -evidence, Status.CONVERGED, stats=stats)

    def finish(self, observations: Observations, association: Association) -> Tracks:
        """The tracks of objects, gaps filled and boxes smoothed where the camera rests.

        Raises:
            ValueError: The association was not made by a tracker of this kind.
        """
        followed = association.stats.get("followed")
        if followed is None:
            raise ValueError("association: expected what associate() of this tracker returned")
        label = np.full(len(observations), -1)
        dropped = confident = 0
        for one in followed.values():
            own = one.boxes.label
            keep = np.append(one.objects > self.post.object_odds, False)[own]
            label[one.rows[keep]] = own[keep] + label.max(initial=-1) + 1
            sure = one.boxes.odds > 0
            confident += int(sure.sum())
            dropped += int((sure & ~keep).sum())
        self._warn(len(observations), label, confident, dropped)
        tracks = Tracks.from_labels(observations, torch.from_numpy(numbered(label)))
        rate = self._frame_rate(observations)
        parts = [
            self._post_processed(tracks.select(tracks.camera == number), one, number, rate)
            for number, one in followed.items()
        ]
        return _side_by_side(parts) if parts else tracks

    def update(self, detections: Any) -> Any:
        """Track the next frame: ``supervision.Detections`` in, those on a track out, with ids.

        Identities count from 1 without holes and never change. A track is shown from the frame on
        in which its boxes together say that it is an object. Masks, classes and data come back.

        Args:
            detections: What a detector found in the next frame; frames without any count, too.

        Only boxes are looked at: ``camera`` and ``scorers`` need whole observations.

        Raises:
            ValueError: The tracker was made without ``frame_rate``, or with ``camera`` or
                ``scorers``.
        """
        if self._stream is None:
            for name in ("camera", "scorers"):
                if getattr(self, name):
                    raise ValueError(
                        f"{name}: update() looks at boxes alone; use associate() with online=True"
                    )
            if self.frame_rate is None:
                raise ValueError(
                    "frame_rate: expected frames a second, got none: Tracker(frame_rate=30).update"
                )
            follower = Follower(self.weights, self.linking, self.frame_rate)
            self._stream = Stream(follower, self.across_categories, self.post.object_odds)
        return self._stream.update(detections)

    def reset(self) -> None:
        """Forget the frames that :meth:`update` was given: the next one begins a new sequence."""
        self._stream = None

    def _follow(
        self,
        observations: Observations,
        rows: np.ndarray,
        camera: int,
        rate: float,
        latency: list[float],
        progress: Progress | None,
    ) -> Followed:
        """Follow what one camera saw."""
        sequence = self._sequence(observations, rows)
        rate /= sequence.step
        steps = self._known_steps(observations, sequence, camera, progress)
        extra = ScorerEvidence(self.scorers, observations, rows) if self.scorers else None
        follower = Follower(self.weights, self.linking, rate, extra)
        if self.online:
            boxes, measured = follow_online(sequence, steps, follower, latency, progress)
        else:
            boxes, measured = follow_whole(sequence, steps, follower, progress)
            columns = boxes.odds, boxes.most_overlap, boxes.neighbours
            label = joined(
                boxes.label, sequence, columns, measured, self.weights, self.joining, rate
            )
            boxes = boxes.relabelled(label)
        judged = self.weights["tracks"](track_features(boxes))
        return Followed(rows, sequence, measured, boxes, judged)

    def _sequence(self, observations: Observations, rows: np.ndarray) -> Sequence:
        """The detections of one camera, in order of frames."""
        index = torch.from_numpy(rows)

        def column(name: str) -> np.ndarray:
            return observations[name].detach().cpu()[index].numpy()

        def where_there(name: str) -> np.ndarray | None:
            return column(name) if name in observations.features else None

        category = None if self.across_categories else where_there("category")
        box = column("box").astype(np.float64)
        return Sequence.of(column("frame"), box, where_there("confidence"), category)

    def _known_steps(
        self,
        observations: Observations,
        sequence: Sequence,
        camera: int,
        progress: Progress | None,
    ) -> np.ndarray | None:
        """The camera's steps where they do not come from the boxes, in units of the sequence."""
        path = self.camera
        if isinstance(path, CameraMotion):
            path = path.path(observations, progress)
        if path is None or not len(sequence.frames):
            return None
        middle = np.stack(
            [
                sequence.box[rows, :2].mean(0) if rows.stop > rows.start else np.zeros(2)
                for rows in map(sequence.rows, range(len(sequence.frames)))
            ]
        )
        steps = steps_of(path, camera, sequence.frames, middle * sequence.unit)
        steps[:, 1:] /= sequence.unit
        return steps

    def _post_processed(self, tracks: Tracks, one: Followed, camera: int, rate: float) -> Tracks:
        """Gaps filled and boxes smoothed, where the camera rests."""
        steps = one.measured.camera.copy()
        steps[:, 1:] *= one.measured.unit
        path = path_of_steps(steps, camera, one.sequence.frames)
        resting = interpolated(path.steadied(tracks), self.post.fill * rate, one.sequence.step)
        width = self.post.smoothing * bandwidth(one.measured.jitter, one.measured.change)
        return path.restored(smoothed(resting, width))

    def _usable(self, observations: Observations) -> np.ndarray:
        """(m,) which observations have a box that was measured."""
        box = observations["box"].detach().double().cpu().numpy()
        good = np.isfinite(box).all(1)
        flat = good & (box[:, 2:] <= box[:, :2]).any(1)
        if flat.any():
            raise ValueError(f"box: expected x1 < x2 and y1 < y2, got {box[flat][0]}")
        return good

    def _frame_rate(self, observations: Observations) -> float:
        """Frames a second: as was said, or as ``time`` says."""
        if self.frame_rate is not None:
            return self.frame_rate
        if "time" not in observations.features:
            raise ValueError(
                "frame_rate: expected frames a second, or observations with a feature 'time'; "
                "got neither: Tracker(frame_rate=30)"
            )
        frame = observations["frame"].double()
        span = float(frame.max() - frame.min()) if len(frame) else 0.0
        if not span:
            return 1.0
        time_ = observations["time"].double()
        if not bool(time_.isfinite().all()):
            raise ValueError("time: expected finite numbers, got NaN")
        seconds = float(time_.max() - time_.min())
        if seconds <= 0:
            raise ValueError("time: expected times that rise with frames, got all alike")
        return span / seconds

    def _warn(self, count: int, label: np.ndarray, confident: int, dropped: int) -> None:
        """A word where the result is not what anybody wants."""
        if count and (label < 0).all():
            warnings.warn(
                f"all of {count} detections were taken for clutter, so there is no track: see what "
                "was measured in stats['measured'], and lower birth_odds of Linking",
                stacklevel=3,
            )
        elif dropped > MANY_DROPPED * max(confident, 1):
            warnings.warn(
                f"{dropped} of {confident} detections that look like objects are on no track: see "
                "what was measured in stats['measured'], and lower birth_odds of Linking",
                stacklevel=3,
            )


def _side_by_side(parts: Listed[Tracks]) -> Tracks:
    """The tracks of several cameras together."""
    names = ("frame", "identity", "box", "confidence", "camera", "observation")
    return Tracks(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
