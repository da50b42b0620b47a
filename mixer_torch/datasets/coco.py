"""Annotations and detections in JSON in the style of COCO."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mixer_torch.datasets.base import Dataset, check_file, find
from mixer_torch.observations import FolderFrames, Images, Observations

FRAME = ("frame_id", "frame_index", "frame")
TRACK = ("track_id", "instance_id")
SCORE = ("score", "conf", "confidence")


class COCO(Dataset):
    """A JSON file in the style of COCO, with or without tracks: each image is a view.

    The file is an object with ``images`` and ``annotations`` (and ``categories``), or, as COCO has
    results, a list of annotations with an ``image_id`` each. Regions of a crowd (``iscrowd``) are
    left out. Views are numbered in order of video and frame.

    Features: ``frame``: ``frame_id``, ``frame_index`` or ``frame`` of the image, the first of these
    that all images have, or else the image's ``id``; ``camera``: ``video_id``, 0 where not all
    images have one; ``box``; ``confidence``, where there are scores; ``identity``, where there are
    tracks (``track_id`` or ``instance_id``), -1 for a box of none; ``category``; ``time``, where
    there is a frame rate.

    Args:
        path: The file, as it is or inside ``$MIXER_DATA``.
        images: Folder that the images' ``file_name`` is in; that of the file if None.
        categories: Names or ids of the categories to keep; all if None.
        min_confidence: Leave out boxes of a score under this, or of none.
        start: First frame; from the beginning if None.
        stop: Last frame, included; to the end if None.
        step: From one frame to the next, counting from ``start``, or 0.
        frame_rate: Frames per second: ``time`` is frame / frame_rate.
        pixels: Whether to attach images; if None, where all that have boxes are there.
    """

    def __init__(
        self,
        path: str | Path,
        images: str | Path | None = None,
        categories: Sequence[int | str] | None = None,
        min_confidence: float | None = None,
        start: int | None = None,
        stop: int | None = None,
        step: int = 1,
        frame_rate: float | None = None,
        pixels: bool | None = None,
    ) -> None:
        if step < 1:
            raise ValueError(f"step: expected 1 or more, got {step}")
        if frame_rate is not None and not frame_rate > 0:
            raise ValueError(f"frame_rate: expected a positive number, got {frame_rate}")
        self.path = Path(path)
        self.images = images
        self.categories = categories
        self.min_confidence = min_confidence
        self.start, self.stop, self.step = start, stop, step
        self.frame_rate = frame_rate
        self.pixels = pixels

    def load(self) -> Observations:
        path = find(self.path)
        boxes = read_annotations(path)
        flat = ~(boxes.box[:, 2:] > boxes.box[:, :2]).all(1)
        boxes.refuse(flat, "bbox", "a positive width and height", boxes.box)
        rows = np.flatnonzero(self._chosen(boxes))
        rows = rows[np.argsort(boxes.view[rows], kind="stable")]
        features = {
            "frame": boxes.frame[rows],
            "camera": boxes.camera[rows],
            "box": boxes.box[rows].astype(np.float32),
            "category": boxes.category[rows],
        }
        if not np.isnan(boxes.score).all():
            features["confidence"] = boxes.score[rows].astype(np.float32)
        if (boxes.track >= 0).any():
            features["identity"] = boxes.track[rows]
        if self.frame_rate is not None:
            features["time"] = features["frame"] / self.frame_rate
        return Observations(
            torch.from_numpy(boxes.view[rows]),
            {name: torch.from_numpy(value) for name, value in features.items()},
            self._images(path, boxes, rows),
        )

    def _chosen(self, boxes: Annotations) -> np.ndarray:
        keep = (boxes.frame - (self.start or 0)) % self.step == 0
        if self.start is not None:
            keep &= boxes.frame >= self.start
        if self.stop is not None:
            keep &= boxes.frame <= self.stop
        if self.min_confidence is not None:
            keep &= boxes.score >= self.min_confidence
        if self.categories is not None:
            ids = [boxes.category_of(category) for category in self.categories]
            keep &= np.isin(boxes.category, ids)
        return keep

    def _images(self, path: Path, boxes: Annotations, rows: np.ndarray) -> Images | None:
        if self.pixels is False:
            return None
        view, index = np.unique(boxes.view[rows], return_inverse=True)
        names = [boxes.file_names[k] for k in view]
        folder = path.parent if self.images is None else find(self.images)
        files = [folder / name for name in names if name is not None]
        if len(files) == len(names) and (self.pixels or all(file.is_file() for file in files)):
            return Images(FolderFrames(files), index, boxes.box[rows])
        if self.pixels:
            raise ValueError(f"{path}: expected a 'file_name' of every image, as pixels is true")
        return None


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
    """Read the boxes of a file as :class:`COCO` describes it.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is malformed; the message names the image or the annotation.
    """
    content = _read(path)
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
        box=np.array(column(("bbox",), _corners), dtype=np.float64).reshape(-1, 4),
        score=np.array(column(SCORE, _number, np.nan), dtype=np.float64),
        track=np.array(column(TRACK, _whole, -1), dtype=np.int64).clip(min=-1),
        category=category,
        categories=_categories(path, content, category),
        file_names=file_names,
    )


def _read(path: Path) -> Any:
    check_file(path)
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}, line {error.lineno}: not JSON: {error.msg}") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not text: {error}") from None


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


def _corners(value: Any) -> list[float]:
    if not isinstance(value, list) or len(value) != 4:
        raise ValueError(f"expected [left, top, width, height], got {value!r}")
    left, top, width, height = map(_number, value)
    return [left, top, left + width, top + height]
