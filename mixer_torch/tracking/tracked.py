"""Observations, and the tracklets that the frames between them make."""

from __future__ import annotations

import torch
from jaxtyping import Int64
from torch import Tensor

from mixer_torch.datasets.base import Dataset
from mixer_torch.observations import Observations
from mixer_torch.tracking.tracker import Tracker
from mixer_torch.tracking.tracklets import tracklet_features


class Tracked(Dataset):
    """Sparse frames of a video, and which tracklet of the whole video each observation is of.

    Where only every so many frames are associated, because only those have pixels or because that
    is enough, the detections of the frames between still tell a good deal: tracked from frame to
    frame, most of them make tracklets. Features beside those of ``observed``:
    :data:`~mixer_torch.tracking.tracklets.TRACKLET_FEATURES`, which tell of which tracklet each
    observation is. :class:`mixer_torch.scorers.tracklet.Tracklet` compares them.

    Args:
        observed: What is to be associated; with ``frame`` and ``box``.
        video: All detections, with ``frame``, ``time`` and ``box``; those of ``observed`` among
            them. Pixels and truth are not looked at unless the tracker has scorers of looks.
        tracker: How they are tracked; without ``gaps`` in time, tracklets are left as level one
            makes them.

    Raises:
        ValueError: When it loads: something that is observed is not in the video.
        KeyError: When it loads: a feature is missing.
    """

    def __init__(self, observed: Dataset, video: Dataset, tracker: Tracker) -> None:
        self.observed = observed
        self.video = video
        self.tracker = tracker

    def load(self) -> Observations:
        observed, video = self.observed.load(), self.video.load()
        rows = places(observed, video)
        labels = self.tracker.associate(video).labels
        if labels is None:
            raise ValueError("tracker: expected one whose solver always gives labels")
        tracklets = self.tracker.tracklets(video, labels)
        return observed.with_features(**tracklet_features(tracklets, labels[rows]))


def places(observed: Observations, video: Observations) -> Int64[Tensor, " m"]:
    """Where in the video each observation is, by camera, frame and box.

    Raises:
        ValueError: One is not there.
    """
    where: dict[tuple[float, ...], list[int]] = {}
    for row, key in enumerate(_keys(video)):
        where.setdefault(key, []).append(row)
    found = []
    for key in _keys(observed):
        rows = where.get(key)
        if not rows:
            frame, box = int(key[1]), [round(x, 2) for x in key[2:]]
            raise ValueError(
                f"video: expected all that is observed, got no box {box} in frame {frame}"
            )
        found.append(rows.pop(0))
    return torch.tensor(found, dtype=torch.int64)


def _keys(observations: Observations) -> list[tuple[float, ...]]:
    camera = observations.camera
    columns = [camera[:, None], observations["frame"][:, None], observations["box"]]
    return [tuple(row) for row in torch.cat([x.double() for x in columns], 1).tolist()]
