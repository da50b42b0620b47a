"""How a camera moves from frame to frame, seen in the pixels of what rests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from mixer_torch.extras import require
from mixer_torch.observations import Images, Observations
from mixer_torch.scoring import Progress
from mixer_torch.tracking.camera_path import CameraPath, accumulated, frames_and_cameras

QUALITY = 0.01  # of the weakest corner, as a share of the best one's
SPACING = 8  # pixels between corners
FLOW_WINDOW = (21, 21)
FLOW_LEVELS = 3  # halvings of the picture, in which large motions are small
LARGEST = 2.0  # ratio of scales from frame to frame, either way, that a camera can have
MARGIN = 0.1  # by which boxes are widened on each side, as a share of their sides


class CameraMotion:
    """Where a camera looked, from the pixels around what was detected.

    From each frame in which something was observed to the next such one of the same camera,
    corners outside of the boxes (people move) are followed by the pyramidal optical flow of Lucas
    and Kanade, in grey pictures scaled down, beginning at the shift at which the phases of both
    pictures correlate best (or else at none), and the similarity (shift, turn, scale) that most of
    them agree with is found by RANSAC and refined on these. Where too few agree, or the picture
    moves by next to nothing, the camera is taken to rest. Steps become positions as
    :func:`~mixer_torch.tracking.camera_path.accumulated` says. The same pixels always give
    the same path.

    One similarity stands for the whole picture, so it is right for cameras that turn, roll, zoom
    or shake. Where the camera itself travels, near and far things move differently, and what is
    taken out is the motion of the larger part.

    Args:
        width: Width of the pictures that are looked at, pixels; larger ones are scaled down.
        corners: How many to follow, at most.
        tolerance: By how many of these pixels a corner may miss where it agrees.
        min_points: Corners that have to agree.
        min_share: Share of those found again that has to agree.
        still: By how many of these pixels no part of the picture moves where the camera rests. It
            keeps noise from adding up; a pan as slow as that is motion like any other.
        memory: For how long scale and angle are remembered, seconds (to 1 / e).

    Raises:
        ValueError: An argument is out of range.
    """

    def __init__(
        self,
        width: int = 480,
        corners: int = 400,
        tolerance: float = 1.0,
        min_points: int = 12,
        min_share: float = 0.3,
        still: float = 0.25,
        memory: float = 2.0,
    ) -> None:
        if width < 32:
            raise ValueError(f"width: expected 32 or more, got {width}")
        if not 3 <= min_points <= corners:
            raise ValueError(f"min_points: expected 3 .. corners ({corners}), got {min_points}")
        for name, value in (("tolerance", tolerance), ("memory", memory)):
            if not 0 < value < float("inf"):
                raise ValueError(f"{name}: expected a positive number, got {value}")
        if not still >= 0:
            raise ValueError(f"still: expected 0 or more, got {still}")
        if not 0 < min_share <= 1:
            raise ValueError(f"min_share: expected a value in (0, 1], got {min_share}")
        self.width = width
        self.corners = corners
        self.tolerance = tolerance
        self.min_points = min_points
        self.min_share = min_share
        self.still = still
        self.memory = memory

    def path(self, observations: Observations, progress: Progress | None = None) -> CameraPath:
        """The path of each camera, which rests where its first frame with observations is.

        Args:
            observations: With ``frame``, ``time``, ``box`` and images; ``camera`` where there are
                several.
            progress: Told what is done while it goes on.

        Raises:
            KeyError: A feature is missing.
            ValueError: There are no images, or those of one camera differ in size.
        """
        if observations.images is None and len(observations):
            raise ValueError(
                "camera_motion: expected observations with images, as motion is seen in pixels; "
                "got none: attach the frames, or leave camera_motion out"
            )
        frame, camera = frames_and_cameras(observations)
        keys, first, which = np.unique(
            np.stack([camera, frame]), axis=1, return_index=True, return_inverse=True
        )
        which = which.reshape(-1)  # of shape (1, m) in NumPy 2.0
        order, count = np.argsort(which, kind="stable"), np.bincount(which, minlength=len(first))
        rows = np.split(order, np.cumsum(count)[:-1]) if len(first) else []
        begins = np.diff(keys[0], prepend=keys[0, :1] - 1) != 0
        box = observations["box"].detach().double().cpu().numpy()
        boxes = [box[of_frame] for of_frame in rows]
        steps, centre = self._steps(observations.images, first, boxes, begins, progress)
        time = observations["time"].double().cpu().numpy()[first]
        kept = np.exp(-np.abs(np.diff(time, prepend=time[:1])) / self.memory)
        transform = [
            accumulated(steps[one], centre[one][0], kept[one])
            for one in (keys[0] == number for number in np.unique(keys[0]))
        ]
        return CameraPath(keys[0], keys[1], np.concatenate([np.empty((0, 2, 3)), *transform]))

    def _steps(
        self,
        images: Images | None,
        first: Int64[np.ndarray, " F"],
        boxes: Sequence[Float64[np.ndarray, "_ 4"]],
        begins: Bool[np.ndarray, " F"],
        progress: Progress | None,
    ) -> tuple[Float64[np.ndarray, "F 2 3"], Float64[np.ndarray, "F 2"]]:
        """The similarity from the frame before to each frame, and the middle of its picture.

        Args:
            images: Pixels; None where there is no frame.
            first: An observation of each frame, in order of cameras and frames.
            boxes: All boxes of each frame.
            begins: Whether a frame is the first of its camera.
            progress: Told which frame it is.
        """
        steps, centre = np.tile(np.eye(2, 3), (len(first), 1, 1)), np.zeros((len(first), 2))
        if images is None:
            return steps, centre
        before = None
        for k, row in enumerate(first.tolist()):
            after = Picture.of(images.frame(row), boxes[k], self.width)
            if before is not None and not begins[k]:
                steps[k] = self.step(before, after)
            before, centre[k] = after, after.size / 2
            if progress is not None:
                progress("camera motion", k + 1, len(first))
        return steps, centre

    def step(self, before: Picture, after: Picture) -> Float64[np.ndarray, "2 3"]:
        """The similarity from pixels of one frame to those of the next; else the identity.

        Raises:
            ValueError: They differ in size.
        """
        if not np.array_equal(before.size, after.size):
            raise ValueError(
                "images: expected frames of one size from a camera, got "
                f"{before.size.astype(int)} and {after.size.astype(int)} pixels"
            )
        corners = resting_corners(before, self.corners)
        if len(corners) < self.min_points:
            return np.eye(2, 3)
        found = self._agreed(before, after, corners, whole_shift(before, after))
        if found is None:
            found = self._agreed(before, after, corners, np.zeros(2))
        if found is None:
            return np.eye(2, 3)
        ends = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]]) * [*after.size, 1]
        moved = np.linalg.norm(ends @ (found - np.eye(2, 3)).T, axis=1)
        return found if moved.max() > self.still * before.unit.mean() else np.eye(2, 3)

    def _agreed(
        self,
        before: Picture,
        after: Picture,
        corners: Float64[np.ndarray, "n 2"],
        shift: Float64[np.ndarray, " 2"],
    ) -> Float64[np.ndarray, "2 3"] | None:
        """The similarity that enough corners agree with, looked for around a shift."""
        cv2 = require("cv2", extra="vision")

        a, b = followed(before, after, corners, shift)
        if len(a) < self.min_points:
            return None
        tolerance = self.tolerance * float(before.unit.mean())
        found, agree = cv2.estimateAffinePartial2D(
            a, b, ransacReprojThreshold=tolerance, maxIters=1000, confidence=0.999
        )
        if found is None or agree.sum() < max(self.min_points, self.min_share * len(a)):
            return None
        scale = np.linalg.norm(found[:, 0])
        return found if 1 / LARGEST < scale < LARGEST else None


@dataclass(frozen=True)
class Picture:
    """A frame in grey, scaled down, and what not to look at.

    Args:
        grey: The pixels.
        rests: 255 where it may rest, 0 inside of boxes.
        size: Width and height of the frame, pixels.
    """

    grey: UInt8[np.ndarray, "height width"]
    rests: UInt8[np.ndarray, "height width"]
    size: Float64[np.ndarray, " 2"]

    @classmethod
    def of(
        cls, frame: UInt8[np.ndarray, "h w 3"], box: Float64[np.ndarray, "n 4"], width: int
    ) -> Picture:
        """The picture of an RGB frame with boxes x1 y1 x2 y2; a box with NaN hides nothing."""
        cv2 = require("cv2", extra="vision")

        size = np.array([frame.shape[1], frame.shape[0]], dtype=np.float64)
        grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
        if size[0] > width:
            small = (width, max(1, round(size[1] * width / size[0])))
            grey = cv2.resize(grey, small, interpolation=cv2.INTER_AREA)
        rests = np.full_like(grey, 255)
        shape = np.array(grey.shape[::-1])
        box = box[np.isfinite(box).all(1)].reshape(-1, 2, 2)
        margin = MARGIN * (box[:, 1] - box[:, 0])
        low = np.floor((box[:, 0] - margin) / size * shape).clip(0, shape).astype(int)
        high = np.ceil((box[:, 1] + margin) / size * shape).clip(0, shape).astype(int)
        for (left, top), (right, bottom) in zip(low, high, strict=True):
            rests[top:bottom, left:right] = 0
        return cls(grey, rests, size)

    @property
    def unit(self) -> Float64[np.ndarray, " 2"]:
        """Pixels of the frame that one of the picture stands for, across and down."""
        return self.size / self.grey.shape[::-1]


def resting_corners(picture: Picture, count: int) -> Float64[np.ndarray, "n 2"]:
    """The best corners outside of boxes, pixels of the picture, so many at most."""
    cv2 = require("cv2", extra="vision")

    found = cv2.goodFeaturesToTrack(picture.grey, count, QUALITY, SPACING, mask=picture.rests)
    return np.empty((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)


def whole_shift(before: Picture, after: Picture) -> Float64[np.ndarray, " 2"]:
    """By how much the picture as a whole is shifted, pixels of it, where phases correlate best.

    A shift of up to half of the picture is seen, but no turn, and people count as what rests does.
    """
    cv2 = require("cv2", extra="vision")

    window = cv2.createHanningWindow(before.grey.shape[::-1], cv2.CV_32F)
    first, second = (picture.grey.astype(np.float32) for picture in (before, after))
    shift, _ = cv2.phaseCorrelate(first, second, window)
    return np.array(shift)


def followed(
    before: Picture,
    after: Picture,
    corners: Float64[np.ndarray, "n 2"],
    shift: Float64[np.ndarray, " 2"],
) -> tuple[Float64[np.ndarray, "k 2"], Float64[np.ndarray, "k 2"]]:
    """Where corners of one picture are, and where they are in the next, in pixels of the frames.

    Those that are not found again, or outside of the picture, are left out.

    Args:
        before: The picture,
        after: and the next.
        corners: Of the one before, in pixels of the picture.
        shift: By which they are first looked for.
    """
    cv2 = require("cv2", extra="vision")

    found, good, _ = cv2.calcOpticalFlowPyrLK(
        before.grey,
        after.grey,
        corners.astype(np.float32),
        (corners + shift).astype(np.float32),
        winSize=FLOW_WINDOW,
        maxLevel=FLOW_LEVELS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    there = np.asarray(found, dtype=np.float64)
    inside = (there >= 0).all(1) & (there <= np.array(after.grey.shape[::-1]) - 1).all(1)
    inside &= np.asarray(good).ravel() == 1
    here, there = ((place[inside] + 0.5) * before.unit - 0.5 for place in (corners, there))
    return here, there
