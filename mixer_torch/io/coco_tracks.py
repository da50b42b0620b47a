"""Tracks and detections as JSON in the style of COCO."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from mixer_torch.datasets.coco import read_annotations
from mixer_torch.io.files import written_whole
from mixer_torch.io.mot_tracks import from_one
from mixer_torch.observations import Observations
from mixer_torch.tracks import Tracks

CATEGORY = 1


def read_coco(path: str | Path) -> Tracks:
    """Read the tracks of a JSON file; :class:`mixer_torch.datasets.COCO` says what is in one.

    Boxes of no track and regions of a crowd are left out. Where identities count from 0, all
    are raised by 1. A confidence that is not there is not known (NaN).

    Args:
        path: The file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is malformed, it has boxes and no track, or a track is twice in an image;
            the message names the annotation.
    """
    boxes = read_annotations(Path(path))
    rows = np.flatnonzero(boxes.track >= 0)
    if len(boxes.track) and not len(rows):
        raise ValueError(
            f"{path}: no annotation has a 'track_id': these are detections, not tracks"
        )
    seen = np.stack([boxes.view, boxes.track], 1)[rows]
    repeated = np.zeros(len(boxes.track), dtype=bool)
    repeated[np.delete(rows, np.unique(seen, axis=0, return_index=True)[1])] = True
    boxes.refuse(repeated, "track_id", "one that is not in the image already", boxes.track)
    return Tracks(
        boxes.frame[rows],
        from_one(boxes.track[rows]),
        boxes.box[rows],
        boxes.score[rows],
        boxes.camera[rows],
    )


def write_coco(path: str | Path, seen: Tracks | Observations, category: str = "object") -> None:
    """Write ``videos``, ``images``, ``annotations`` and ``categories``.

    Each camera is a video, and each frame that has a box is an image, with the keys ``id``,
    ``video_id`` and ``frame_id``. Annotations have ``bbox`` (left, top, width, height), ``area``,
    ``score`` where the confidence is known, and ``track_id`` where there is an identity.

    Args:
        path: The file.
        seen: Tracks, or observations with ``frame`` and ``box``; those whose box was not measured
            are left out.
        category: What the one category is called.

    Raises:
        KeyError: Observations have no feature ``frame`` or ``box``.
    """
    columns = _of_observations(seen) if isinstance(seen, Observations) else vars(seen)
    place = np.stack([columns["camera"], columns["frame"]], 1)
    images, image = np.unique(place, axis=0, return_inverse=True)
    image_id = image.reshape(-1) + 1
    with written_whole(path) as partial:
        content = {
            "videos": [
                {"id": camera, "name": f"camera {camera}"}
                for camera in np.unique(columns["camera"]).tolist()
            ],
            "images": [
                {"id": k, "video_id": camera, "frame_id": frame}
                for k, (camera, frame) in enumerate(images.tolist(), 1)
            ],
            "annotations": _annotations(image_id.tolist(), columns),
            "categories": [{"id": CATEGORY, "name": category}],
        }
        partial.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")


def _annotations(image_id: list[int], columns: dict[str, Any]) -> list[dict[str, Any]]:
    rows = zip(
        image_id,
        columns["box"].tolist(),
        columns["confidence"].tolist(),
        columns["identity"].tolist(),
        strict=True,
    )
    annotations = []
    for k, (image, (x1, y1, x2, y2), score, identity) in enumerate(rows, 1):
        one: dict[str, Any] = {"id": k, "image_id": image, "category_id": CATEGORY, "iscrowd": 0}
        one |= {"bbox": [x1, y1, x2 - x1, y2 - y1], "area": (x2 - x1) * (y2 - y1)}
        if np.isfinite(score):
            one["score"] = score
        if identity >= 0:
            one["track_id"] = identity
        annotations.append(one)
    return annotations


def _of_observations(seen: Observations) -> dict[str, Any]:
    box = seen["box"].detach().double().cpu().numpy()
    keep = ~np.isnan(box).any(1)
    m = len(seen)
    columns = {"frame": seen["frame"].cpu().numpy(), "box": box}
    defaults = {"camera": 0, "identity": -1, "confidence": np.nan}
    for name, default in defaults.items():
        value = seen.features.get(name)
        columns[name] = np.full(m, default) if value is None else value.detach().cpu().numpy()
    columns["confidence"] = columns["confidence"].astype(np.float64)
    return {name: value[keep] for name, value in columns.items()}
