"""Trackers that people use today, each over a whole sequence and at its defaults.

SORT, ByteTrack, OC-SORT and C-BIoU are those of the package `trackers`, made with no argument:
their ``frame_rate`` of 30 only scales how long a lost track is kept. Detections without a track
(``tracker_id`` -1) are left out. norfair has no default distance: it is "iou" with a threshold of
0.7, the rest as in its signature, and a track is written where norfair's own drawing shows it: its
estimated box, as long as a point of it is live. ARC-SORT is the preset "dancetrack" of the package
`arcsort`, without its camera motion, which needs pixels. A peer that is not installed is left out;
`make peers` installs them all.
"""

from importlib import import_module

import numpy as np

from mixer_torch.tracks import Tracks

PEERS = {
    "SORT": ("trackers", "SORTTracker"),
    "ByteTrack": ("trackers", "ByteTrackTracker"),
    "OC-SORT": ("trackers", "OCSORTTracker"),
    "C-BIoU": ("trackers", "CBIoUTracker"),
    "norfair": ("norfair", "Tracker"),
    "ARC-SORT": ("arcsort", "ARCTracker"),
}
NORFAIR = {"distance_function": "iou", "distance_threshold": 0.7}


def installed():
    """The peers that there are: name -> a way to track, (observations, frames) -> Tracks."""
    ways = {"trackers": _with_trackers, "norfair": _with_norfair, "arcsort": _with_arcsort}
    found = {}
    for name, (package, attribute) in PEERS.items():
        try:
            kind = getattr(import_module(package), attribute)
        except ImportError:
            continue
        run = ways[package]
        found[name] = lambda observations, frames, run=run, kind=kind: _tracks(
            run(kind, *_by_frame(observations, frames))
        )
    return found


def missing():
    """Names of the peers that are not installed."""
    return [name for name in PEERS if name not in installed()]


def _by_frame(observations, frames):
    """Boxes and confidences of frame 1, 2, ..., those without detections included."""
    frame = observations["frame"].numpy()
    order = np.argsort(frame, kind="stable")
    cuts = np.searchsorted(frame[order], np.arange(2, frames + 1))
    values = (observations[name].numpy()[order] for name in ("box", "confidence"))
    return (np.split(value, cuts) for value in values)


def _with_trackers(kind, boxes, confidences):
    """Rows of frame, identity and box of a tracker of the package `trackers`."""
    import supervision

    tracker = kind()
    for frame, (box, confidence) in enumerate(zip(boxes, confidences, strict=True), 1):
        found = tracker.update(supervision.Detections(xyxy=box, confidence=confidence))
        for identity, corners in zip(found.tracker_id, found.xyxy, strict=True):
            if identity >= 0:
                yield frame, identity, *corners


def _with_norfair(kind, boxes, confidences):
    """Rows of frame, identity and box of norfair."""
    from norfair import Detection

    tracker = kind(**NORFAIR)
    for frame, (box, confidence) in enumerate(zip(boxes, confidences, strict=True), 1):
        found = [
            Detection(points=points, scores=np.repeat(score, 2))
            for points, score in zip(box.reshape(-1, 2, 2), confidence, strict=True)
        ]
        for thing in tracker.update(found):
            if thing.live_points.any():
                yield frame, thing.id, *thing.estimate.reshape(-1)


def _with_arcsort(kind, boxes, confidences):
    """Rows of frame, identity and box of ARC-SORT."""
    from loguru import logger

    logger.disable("arcsort")
    tracker = kind.from_preset("dancetrack", use_cmc=False)
    for frame, (box, confidence) in enumerate(zip(boxes, confidences, strict=True), 1):
        rows = np.column_stack([box, confidence, np.zeros(len(box))]).astype(np.float64)
        for *corners, identity in tracker.update(rows.reshape(-1, 6)):
            yield frame, identity, *corners


def _tracks(rows):
    rows = np.array(list(rows), dtype=np.float64).reshape(-1, 6)
    frame, identity = rows[:, :2].astype(np.int64).T
    return Tracks(frame, identity - min(identity.min(initial=1), 1) + 1, rows[:, 2:])
