"""To and from ``Detections`` of the package supervision, one for each frame."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch

from mixer_torch.observations import Observations
from mixer_torch.tracks import Tracks, from_one

OBSERVATION = "observation"


def to_supervision(
    seen: Tracks | Observations, first_frame: int = 1, last_frame: int | None = None
) -> list[Any]:
    """One ``supervision.Detections`` for each frame, empty ones among them.

    ``xyxy`` is float64; ``confidence`` is there where it is known of all boxes; tracks have a
    ``tracker_id``; ``data["observation"]`` is the number of the observation, -1 for none.

    Args:
        seen: Tracks of one camera, or observations of one with ``frame`` and ``box``, of which
            those whose box was not measured are left out.
        first_frame: Frame of the first; boxes before it are left out.
        last_frame: Frame of the last; the last that has a box if None. Boxes after it are left out.

    Raises:
        ImportError: supervision is not installed.
        KeyError: Observations have no feature ``frame`` or ``box``.
        ValueError: There is more than one camera.
    """
    detections = _detections_class()
    if isinstance(seen, Tracks):
        tracks, tracked, known = seen, True, True
    else:
        tracks, tracked = Tracks.from_labels(seen, torch.arange(len(seen))), False
        known = "confidence" in seen.features
    tracks.check_one_camera()
    if last_frame is None:
        last_frame = int(tracks.frame.max(initial=first_frame - 1))
    known = known and not np.isnan(tracks.confidence).any()
    frames = []
    for frame in range(first_frame, last_frame + 1):
        start, stop = np.searchsorted(tracks.frame, [frame, frame + 1])
        rows = slice(start, stop)
        frames.append(
            detections(
                xyxy=tracks.box[rows],
                confidence=tracks.confidence[rows] if known else None,
                tracker_id=tracks.identity[rows] if tracked else None,
                data={OBSERVATION: tracks.observation[rows]},
            )
        )
    return frames


def from_supervision(frames: Iterable[Any], first_frame: int = 1) -> Tracks:
    """The tracks of one ``supervision.Detections`` for each frame.

    Detections of no track (``tracker_id`` -1) are left out. Where identities count from 0, all are
    raised by 1. A confidence that is not there is not known (NaN).

    Args:
        frames: What a tracker returned for each frame, in order.
        first_frame: Frame of the first.

    Raises:
        ValueError: Detections have no ``tracker_id``, or an identity is twice in a frame.
    """
    parts = []
    for frame, found in enumerate(frames, first_frame):
        if len(found) and found.tracker_id is None:
            raise ValueError(f"frames: detections of frame {frame} have no tracker_id")
        identity = found.tracker_id if len(found) else np.empty(0)
        parts.append((_columns(frame, found), np.asarray(identity, dtype=np.int64)))
    columns = _joined(columns for columns, _ in parts)
    identity = np.concatenate([np.empty(0, dtype=np.int64), *(own for _, own in parts)])
    keep = identity >= 0
    kept = {name: value[keep] for name, value in columns.items()}
    return Tracks(identity=from_one(identity[keep]), **kept)


def observations_from_supervision(
    frames: Iterable[Any], first_frame: int = 1, frame_rate: float | None = None
) -> Observations:
    """The detections of one ``supervision.Detections`` for each frame, each frame a view.

    Features: ``frame``; ``camera``, 0; ``box``; ``confidence``, where it is known of any; ``time``,
    frame / frame_rate, where there is a frame rate. What a tracker said is left out.

    Args:
        frames: What a detector found in each frame, in order.
        first_frame: Frame of the first.
        frame_rate: Frames per second.

    Raises:
        ValueError: frame_rate is not positive.
    """
    if frame_rate is not None and not frame_rate > 0:
        raise ValueError(f"frame_rate: expected a positive number, got {frame_rate}")
    columns = _joined(_columns(frame, found) for frame, found in enumerate(frames, first_frame))
    frame = columns["frame"]
    features = {
        "frame": frame,
        "camera": np.zeros_like(frame),
        "box": columns["box"].astype(np.float32),
    }
    if not np.isnan(columns["confidence"]).all():
        features["confidence"] = columns["confidence"].astype(np.float32)
    if frame_rate is not None:
        features["time"] = frame / frame_rate
    return Observations(
        torch.from_numpy(frame),
        {name: torch.from_numpy(value) for name, value in features.items()},
    )


def _detections_class() -> Any:
    try:
        from supervision import Detections
    except ImportError as error:
        raise ImportError(
            f"detections need the package supervision, which does not import ({error}): "
            "pip install supervision"
        ) from error
    return Detections


def _columns(frame: int, found: Any) -> dict[str, np.ndarray]:
    """What the detections of one frame say, whoever they were tracked as."""
    n = len(found)
    confidence = np.full(n, np.nan) if found.confidence is None else found.confidence
    observation = found.data.get(OBSERVATION, np.full(n, -1))
    return {
        "frame": np.full(n, frame),
        "box": np.asarray(found.xyxy, dtype=np.float64).reshape(n, 4),
        "confidence": np.asarray(confidence, dtype=np.float64),
        OBSERVATION: np.asarray(observation, dtype=np.int64),
    }


def _joined(parts: Iterable[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    nothing = {
        "frame": np.empty(0, dtype=np.int64),
        "box": np.empty((0, 4)),
        "confidence": np.empty(0),
        OBSERVATION: np.empty(0, dtype=np.int64),
    }
    columns = [nothing, *parts]
    return {name: np.concatenate([part[name] for part in columns]) for name in nothing}
