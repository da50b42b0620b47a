"""Annotations and detections in JSON in the style of COCO."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mixer_torch.datasets.base import Dataset, FrameRange, check_positive, observations_of
from mixer_torch.io.coco import Annotations, read_annotations
from mixer_torch.io.files import find
from mixer_torch.observations import FolderFrames, Images, Observations


@dataclass(eq=False)
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

    path: str | Path
    images: str | Path | None = None
    categories: Sequence[int | str] | None = None
    min_confidence: float | None = None
    start: int | None = None
    stop: int | None = None
    step: int = 1
    frame_rate: float | None = None
    pixels: bool | None = None

    def __post_init__(self) -> None:
        self.range = FrameRange(self.start, self.stop, self.step)
        check_positive(frame_rate=self.frame_rate)

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
        return observations_of(boxes.view[rows], features, self._images(path, boxes, rows))

    def _chosen(self, boxes: Annotations) -> np.ndarray:
        keep = self.range.contains(boxes.frame)
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
