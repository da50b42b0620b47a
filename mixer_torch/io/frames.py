"""Where the pixels of a MOTChallenge sequence are: a folder of images, or a video."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from mixer_torch.observations import FolderFrames, VideoFrames

VIDEO_SUFFIXES = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".webm")
PLAIN = 32  # brightness of frames without pixels: boxes of all colours stand out
LARGEST_SIDE = 8192  # pixels of a frame without pixels: that of 8K video
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp")


@dataclass(frozen=True, eq=False)
class NumberedFrames:
    """Frames of a sequence, by the numbers that its tables give them.

    Args:
        number: (n,) int64 numbers of the frames that are there, ascending.
        place: (n,) int64 the index in ``frames`` of each.
        frames: The pixels: RGB arrays, decoded when they are asked for.
    """

    number: Any
    place: Any
    # Sequence[Any], as a type checker at run time would decode a frame to see what it is.
    frames: Sequence[Any]

    def __len__(self) -> int:
        return len(self.number)

    def places(self, frame: Int64[np.ndarray, " m"]) -> Int64[np.ndarray, " m"] | None:
        """The index in ``frames`` of each frame number; None where one is not there."""
        found = np.searchsorted(self.number, frame)
        if (found == len(self)).any() or (self.number[found] != frame).any():
            return None
        return self.place[found]


class PlainFrames(Sequence[Any]):
    """Frames of one grey, to draw boxes on where there are no pixels.

    Args:
        total: How many.
        height: Of a frame, pixels.
        width: Of a frame, pixels.
    """

    def __init__(self, total: int, height: int, width: int) -> None:
        self.total = total
        self.frame = np.full((height, width, 3), PLAIN, dtype=np.uint8)

    def __len__(self) -> int:
        return self.total

    def __getitem__(self, index: Any) -> Any:
        if not -self.total <= index < self.total:
            raise IndexError(f"index: expected one under {self.total}, got {index}")
        return self.frame


def plain_frames(
    number: Int64[np.ndarray, " n"], box: Float[np.ndarray, "m 4"], size: tuple[int, int] | None
) -> NumberedFrames:
    """Plain frames with room for all boxes; none where these reach further than any picture.

    Args:
        number: Their numbers.
        box: (m, 4) x1 y1 x2 y2 pixels.
        size: Height and width where they are known.
    """
    if size is None:
        right, bottom = np.nan_to_num(box[:, 2:]).max(0, initial=1.0)
        if max(right, bottom) > LARGEST_SIDE:
            return NumberedFrames(number[:0], number[:0], PlainFrames(0, 2, 2))
        size = math.ceil(bottom), math.ceil(right)
    height, width = (side + side % 2 for side in size)  # encoders want even sides
    return NumberedFrames(number, np.arange(len(number)), PlainFrames(len(number), height, width))


def find_frames(
    folder: Path, image_folder: str, suffix: str, chosen: Callable[[Any], Any]
) -> Iterator[NumberedFrames]:
    """The frames of a sequence in its folder of images, and in its video, as far as there are any.

    Args:
        folder: The sequence's.
        image_folder: Folder of images inside of it, each named after its number.
        suffix: Ending of their names.
        chosen: Of an array of frame numbers, which to take.

    Raises:
        ValueError: There is more than one video, or it does not open.
    """
    if (folder / image_folder).is_dir():
        files = (folder / image_folder).glob(f"*{suffix}")
        images = {int(file.stem): file for file in files if file.stem.isdecimal()}
        number = np.array(sorted(images), dtype=np.int64)
        number = number[chosen(number)]
        frames = FolderFrames([images[k] for k in number.tolist()])
        yield NumberedFrames(number, np.arange(len(number)), frames)
    if (video := find_video(folder)) is not None:
        reader = VideoFrames(video)
        number = np.arange(1, len(reader) + 1)
        number = number[chosen(number)]
        yield NumberedFrames(number, number - 1, reader)


def find_video(folder: Path) -> Path | None:
    """The file in ``video/``, None without one.

    Raises:
        ValueError: There is more than one.
    """
    files = sorted(
        file for file in (folder / "video").glob("*") if file.suffix.lower() in VIDEO_SUFFIXES
    )
    if len(files) > 1:
        raise ValueError(f"{folder}: expected one video, got {[file.name for file in files]}")
    return files[0] if files else None


def usual_suffix(folder: Path) -> str:
    """The ending of the images in a folder, where nobody says it: .jpg unless there are others."""
    found = (file.suffix for file in sorted(folder.glob("*")) if file.stem.isdecimal())
    return next((suffix for suffix in found if suffix.lower() in IMAGE_SUFFIXES), ".jpg")
