"""JSON in the style of COCO: annotations, detections and tracks, in and out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mixer_torch.boxes import corners, left_top_size
from mixer_torch.io.files import read_json, write_json
from mixer_torch.io.text import repeated
from mixer_torch.observations import Observations
from mixer_torch.tracks import Tracks, from_one

CATEGORY = 1
"""Id of the one category that is written."""
FRAME = ("frame_id", "frame_index", "frame")
TRACK = ("track_id", "instance_id")
SCORE = ("score", "conf", "confidence")


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
    again = np.zeros(len(boxes.track), dtype=bool)
    again[rows] = repeated(np.stack([boxes.view, boxes.track], 1)[rows])
    boxes.refuse(again, "track_id", "one that is not in the image already", boxes.track)
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
    write_json(path, content, indent=None, allow_nan=False)


def _annotations(image_id: list[int], columns: dict[str, Any]) -> list[dict[str, Any]]:
    rows = zip(
        image_id,
        left_top_size(columns["box"]).tolist(),
        columns["confidence"].tolist(),
        columns["identity"].tolist(),
        strict=True,
    )
    annotations = []
    for k, (image, box, score, identity) in enumerate(rows, 1):
        one: dict[str, Any] = {"id": k, "image_id": image, "category_id": CATEGORY, "iscrowd": 0}
        one |= {"bbox": box, "area": box[2] * box[3]}
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


@dataclass(frozen=True, eq=False)
class Annotations:
    """n boxes of a file, those of crowds left out, and what is known of the images.

    Args:
        path: The file.
        place: (n,) which of the file's annotations each box is, from 0.
        view: (n,) which image it is in, images in order of camera and frame.
        frame: (n,) the image's frame.
        camera: (n,) the image's video.
        box: (n, 4) x1 y1 x2 y2.
        score: (n,) NaN where there is none.
        track: (n,) -1 where there is none.
        category: (n,) its id, -1 where there is none.
        categories: Names of categories by id, as far as the file has them.
        file_names: Of the images, in order of camera and frame; None where there is none.
    """

    path: Path
    place: np.ndarray
    view: np.ndarray
    frame: np.ndarray
    camera: np.ndarray
    box: np.ndarray
    score: np.ndarray
    track: np.ndarray
    category: np.ndarray
    categories: Mapping[int, str]
    file_names: Sequence[str | None]

    def category_of(self, category: int | str) -> int:
        """The id of a category by name or id; ValueError lists those that there are."""
        for number, name in self.categories.items():
            if category in (number, name):
                return number
        have = ", ".join(f"{name} ({number})" for number, name in self.categories.items())
        raise ValueError(f"categories: expected some of {have or 'none'}, got {category!r}")

    def refuse(self, wrong: Any, key: str, expected: str, got: Any) -> None:
        """ValueError that names the first annotation that is wrong, and what is there."""
        if np.any(wrong):
            first = int(np.argmax(wrong))
            raise ValueError(
                f"{self.path}: annotations[{self.place[first]}]: {key}: expected {expected}, "
                f"got {np.asarray(got)[first].tolist()}"
            )


def read_annotations(path: Path) -> Annotations:
    """Read the boxes of a file as :class:`mixer_torch.datasets.COCO` describes it.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is malformed; the message names the image or the annotation.
    """
    content = read_json(path)
    if isinstance(content, list):
        content = {"annotations": content}
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected an object or a list, got {type(content).__name__}")
    annotations = _objects(path, content, "annotations")
    place = np.array(
        [k for k, one in enumerate(annotations) if not one.get("iscrowd")], dtype=np.int64
    )
    kept = [(int(k), annotations[k]) for k in place]
    if "images" not in content:
        ids = {_get(path, "annotations", k, one, ("image_id",), _whole) for k, one in kept}
        content = {**content, "images": [{"id": number} for number in sorted(ids)]}
    view, frame, camera, file_names = _images(path, _objects(path, content, "images"))

    def column(names: tuple[str, ...], read: Any, default: Any = None) -> list[Any]:
        return [_get(path, "annotations", k, one, names, read, default) for k, one in kept]

    image = column(("image_id",), _hashable)
    for (k, _), number in zip(kept, image, strict=True):
        if number not in view:
            raise ValueError(f"{path}: annotations[{k}]: there is no image {number!r}")
    views = np.array([view[number] for number in image], dtype=np.int64)
    category = np.array(column(("category_id",), _whole, -1), dtype=np.int64)
    return Annotations(
        path=path,
        place=place,
        view=views,
        frame=frame[views],
        camera=camera[views],
        box=corners(np.array(column(("bbox",), _box), dtype=np.float64).reshape(-1, 4)),
        score=np.array(column(SCORE, _number, np.nan), dtype=np.float64),
        track=np.array(column(TRACK, _whole, -1), dtype=np.int64).clip(min=-1),
        category=category,
        categories=_categories(path, content, category),
        file_names=file_names,
    )


def _images(
    path: Path, images: list[Any]
) -> tuple[dict[Any, int], np.ndarray, np.ndarray, list[str | None]]:
    """The view of each image by its id, and of each view frame, camera and file."""

    def column(name: str) -> np.ndarray:
        rows = enumerate(images)
        return np.array(
            [_get(path, "images", k, one, (name,), _whole) for k, one in rows], np.int64
        )

    key = next((name for name in FRAME if all(name in one for one in images)), "id")
    frame = column(key)
    videos = all(one.get("video_id") is not None for one in images)
    camera = column("video_id") if videos else np.zeros(len(images), dtype=np.int64)
    place: dict[Any, int] = {}
    where: dict[Any, int] = {}
    order = np.lexsort((frame, camera))
    for view, k in enumerate(order.tolist()):
        number = _get(path, "images", k, images[k], ("id",), _hashable)
        here = int(camera[k]), int(frame[k])
        if number in place or here in where:
            twin = f"id {number!r}" if number in place else f"frame {here[1]} of video {here[0]}"
            raise ValueError(f"{path}: images[{k}]: {twin} is there already")
        place[number] = where[here] = view
    return place, frame[order], camera[order], [images[k].get("file_name") for k in order]


def _categories(path: Path, content: Mapping[str, Any], used: np.ndarray) -> dict[int, str]:
    named = {}
    for k, one in enumerate(_objects(path, content, "categories", [])):
        number = _get(path, "categories", k, one, ("id",), _whole)
        named[number] = str(one.get("name", number))
    return {number: str(number) for number in np.unique(used[used >= 0]).tolist()} | named


def _objects(path: Path, content: Mapping[str, Any], key: str, default: Any = None) -> list[Any]:
    """A list of objects of the file."""
    values = content.get(key, default)
    if not isinstance(values, list):
        found = "none" if values is None else type(values).__name__
        raise ValueError(f"{path}: expected a list {key!r}, got {found}")
    for k, one in enumerate(values):
        if not isinstance(one, dict):
            raise ValueError(f"{path}: {key}[{k}]: expected an object, got {type(one).__name__}")
    return values


def _get(
    path: Path,
    group: str,
    k: int,
    one: Mapping[str, Any],
    names: tuple[str, ...],
    read: Any,
    default: Any = None,
) -> Any:
    """The first of some keys that an object has, checked; the default where it has none."""
    for name in names:
        value = one.get(name)
        if value is None:
            continue
        try:
            return read(value)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: {group}[{k}]: {name}: {error}") from None
    if default is None:
        raise ValueError(f"{path}: {group}[{k}]: {names[0]!r} is missing")
    return default


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(f"expected a finite number, got {value!r}")
    return float(value)


def _whole(value: Any) -> int:
    if _number(value) % 1:
        raise ValueError(f"expected a whole number, got {value!r}")
    return int(value)


def _hashable(value: Any) -> Any:
    if isinstance(value, list | dict):
        raise ValueError(f"expected a number or a name, got {value!r}")
    return value


def _box(value: Any) -> list[float]:
    if not isinstance(value, list) or len(value) != 4:
        raise ValueError(f"expected [left, top, width, height], got {value!r}")
    return list(map(_number, value))
