"""Several synchronised cameras that see one place: a table of boxes and a calibration each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64, Int64

from mixer_torch.boxes import check_min_overlap, foot_points, true_identities
from mixer_torch.datasets.base import (
    Dataset,
    FrameRange,
    check_images,
    check_not_negative,
    check_positive,
    check_source,
    in_space,
    observations_of,
)
from mixer_torch.datasets.calibration import Calibration, read_calibration
from mixer_torch.datasets.joined_frames import JoinedFrames
from mixer_torch.datasets.local_motion import local_motion
from mixer_torch.io.box_tables import Boxes, read_boxes
from mixer_torch.io.files import find
from mixer_torch.observations import FolderFrames, Images, Observations, VideoFrames


@dataclass(frozen=True)
class Camera:
    """One camera of several. Paths are as they stand or inside ``$MIXER_DATA``.

    Args:
        boxes: Table of detections, in a format of :func:`mixer_torch.io.box_tables.read_boxes`:
            MOTChallenge or VATIC text, or JSON, packed (``.gz``) or not.
        calibration: From pixels to the ground that all cameras share: ``.xml`` (Tsai), ``.json``
            (K, R and t or centre), ``.mat`` (as of the CAMPUS data set), or text of a 3x3
            homography; None where there is none, and then no position.
        truth: Table of true boxes, whose identities are those of all cameras.
        name: Which camera of a calibration file of several.
        delay: Frame k of the tables is frame k - delay of the clock that all cameras share.
        images: Where the image of a frame is: a pattern with the number that the tables give it,
            such as ``left/{frame:06d}.jpg``; None where there are no pixels.
        video: The video that the frames are from, instead of ``images``.
        first_frame: What the tables call the first frame of the video.

    Raises:
        ValueError: There are both images and a video.
    """

    boxes: str | Path
    calibration: str | Path | None = None
    truth: str | Path | None = None
    name: str | None = None
    delay: int = 0
    images: str | None = None
    video: str | Path | None = None
    first_frame: int = 0

    def __post_init__(self) -> None:
        check_images(self.images, self.video)

    def frames(
        self, frame: Int64[np.ndarray, " n"]
    ) -> tuple[Sequence[Any], Int64[np.ndarray, " n"]]:
        """The pixels of some frames, in the tables' count, and which of them each is.

        Raises:
            FileNotFoundError: An image, or the video, is missing.
            ValueError: The pattern does not fit, or the video has no such frame.
        """
        if self.video is not None:
            video = VideoFrames(find(self.video))
            index = frame - self.first_frame
            wrong = (index < 0) | (index >= len(video))
            if wrong.any():
                last = self.first_frame + len(video) - 1
                raise ValueError(
                    f"{self.boxes}: frame {frame[wrong.argmax()]}: {self.video} has frames "
                    f"{self.first_frame} to {last}"
                )
            return video, index
        chosen, index = np.unique(frame, return_inverse=True)
        try:
            names = [str(self.images).format(frame=int(k)) for k in chosen]
        except (ValueError, KeyError, IndexError) as error:
            raise ValueError(
                f"images: expected a pattern with {{frame}}, got {self.images!r}: {error!r}"
            ) from error
        return FolderFrames([find(name) for name in names]), index.reshape(-1)


@dataclass(eq=False)
class MultiCamera(Dataset):
    """Boxes of several cameras with one frame rate, on one clock, in one frame of the world.

    Each pair of camera and frame is one view, numbered frame * cameras + camera (from the first
    frame if that is negative), and identities are the same in all cameras.

    Features: ``frame``, of the common clock; ``time``, frame / frame_rate; ``camera``, from 0;
    ``box``, pixels of that camera; ``confidence``; ``identity`` where there is truth, that of the
    true box which the detection is assigned to, -1 for clutter; ``position`` where cameras are
    calibrated, the ground point under the middle of the box's lower edge, z = 0, NaN for boxes
    above the horizon; and with ``window`` also ``velocity``, metres a second, NaN where it could
    not be measured. Rows are in order of frames, then cameras.

    Args:
        cameras: One or more.
        frame_rate: Frames per second, of all cameras.
        start: First frame; the first that there is if None.
        stop: Last frame, included; to the end if None.
        step: From one frame to the next, counting from ``start``, or from 0 if that is None.
        source: Observe the detections, or the true boxes.
        min_confidence: Leave out detections under this.
        min_overlap: Intersection over union from which a detection is a true box's.
        depth: How far behind the near edge of what it stands on an object's middle is, metres. A
            box ends at the near edge, so that without it two cameras that look at a person from
            two sides see two places.
        window: Seconds before and after an observation whose frames are used, too: position and
            velocity are those of a straight path through them. They are the frames between
            those that ``step`` leaves, also. 0 for none, and no velocity.

    Raises:
        ValueError: An argument is out of range; or some cameras have truth, a calibration or
            pixels, and others none.
    """

    cameras: Sequence[Camera]
    frame_rate: float
    start: int | None = None
    stop: int | None = None
    step: int = 1
    source: Literal["det", "gt"] = "det"
    min_confidence: float | None = None
    min_overlap: float = 0.5
    depth: float = 0.0
    window: float = 0.0

    def __post_init__(self) -> None:
        if not len(self.cameras):
            raise ValueError("cameras: expected at least one, got none")
        check_positive(frame_rate=self.frame_rate)
        self.range = FrameRange(self.start, self.stop, self.step)
        check_source(self.source)
        check_min_overlap(self.min_overlap)
        check_not_negative(depth=self.depth, window=self.window)
        cameras = self.cameras
        _check_all("truth", [camera.truth for camera in cameras], needed=self.source == "gt")
        _check_all("calibration", [camera.calibration for camera in cameras], self.window > 0)
        _check_all("images, video", [camera.images or camera.video for camera in cameras])

    def load(self) -> Observations:
        parts = [self._load(k, camera) for k, camera in enumerate(self.cameras)]
        features = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        order = np.lexsort((features["camera"], features["frame"]))
        features = {name: value[order] for name, value in features.items()}
        frame = features["frame"]
        # A negative view is no view, and a delay can bring frames before the first.
        view = (frame - frame.min(initial=0)) * len(self.cameras) + features["camera"]
        return observations_of(view, features, self._images(features))

    def _images(self, features: dict[str, np.ndarray]) -> Images | None:
        """The pixels of all cameras, where they have any."""
        if not (self.cameras[0].images or self.cameras[0].video):
            return None
        parts: list[Sequence[Any]] = []
        index = np.empty_like(features["frame"])
        for number, camera in enumerate(self.cameras):
            mine = features["camera"] == number
            frames, place = camera.frames(features["frame"][mine] + camera.delay)
            index[mine] = place + sum(map(len, parts))
            parts.append(frames)
        return Images(JoinedFrames(parts), index, features["box"])

    def _load(self, number: int, camera: Camera) -> dict[str, np.ndarray]:
        """The features of what one camera saw."""
        truth = None if camera.truth is None else read_boxes(find(camera.truth), truth=True)
        if self.source == "gt" and truth is not None:
            boxes = truth
        else:
            boxes = read_boxes(find(camera.boxes))
        if self.min_confidence is not None:
            boxes = boxes.select(boxes.confidence >= self.min_confidence)
        frame = boxes.frame - camera.delay
        rows = np.flatnonzero(self.range.contains(frame))
        chosen = boxes.select(rows)
        features = {
            "frame": frame[rows],
            "time": frame[rows] / self.frame_rate,
            "camera": np.full(len(rows), number, dtype=np.int64),
            "box": chosen.box.astype(np.float32),
            "confidence": chosen.confidence.astype(np.float32),
        }
        if truth is not None:
            features["identity"] = (
                chosen.identity
                if self.source == "gt"
                else true_identities(
                    chosen.frame,
                    chosen.box,
                    truth.frame,
                    truth.box,
                    truth.identity,
                    self.min_overlap,
                )
            )
        if camera.calibration is not None:
            ground = read_calibration(find(camera.calibration), camera.name)
            features |= self._places(ground, boxes, rows)
        return features

    def _places(
        self, ground: Calibration, boxes: Boxes, rows: Int64[np.ndarray, " m"]
    ) -> dict[str, np.ndarray]:
        """Position of the chosen rows, and velocity where there is a window."""
        point = standing_points(ground, boxes.box, self.depth)
        if not self.window:
            return {"position": in_space(point[rows])}
        place, velocity = local_motion(
            boxes.frame, boxes.box, point, rows, self.frame_rate, self.window
        )
        return {"position": in_space(place), "velocity": in_space(velocity)}


def standing_points(
    ground: Calibration, box: Float64[np.ndarray, "n 4"], depth: float = 0.0
) -> Float64[np.ndarray, "n 2"]:
    """Where what is in each box stands, metres on the ground; NaN above the horizon.

    That is the ground point of the middle of the lower edge, moved away from the camera by
    ``depth``: in the direction in which the ground point moves as the pixel does upwards.
    """
    foot = foot_points(box)
    point = ground.to_ground(foot)
    if not depth:
        return point
    away = point - ground.to_ground(foot + np.array([0.0, 1.0]))
    return point + depth * away / np.linalg.norm(away, axis=1, keepdims=True)


def _check_all(name: str, values: Sequence[str | Path | None], needed: bool = False) -> None:
    """ValueError where some cameras lack a file that others have, or that is needed."""
    without = [k for k, value in enumerate(values) if value is None]
    if without and (needed or len(without) < len(values)):
        raise ValueError(
            f"{name}: expected a file for every camera{'' if needed else ' or for none'}, "
            f"got none for cameras {without}"
        )
