"""What was seen: observations of objects in many views, and the pixels they were seen in."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from mixer_torch.extras import require
from mixer_torch.io.files import load_npz, save_npz

FORMAT = "mixer-torch observations 1"
FLOAT_FEATURES = {"time": torch.float64, "box": torch.float32, "position": torch.float32}
INT_FEATURES = ("frame", "camera", "identity")
SHAPES: dict[str, tuple[int | str, ...]] = {
    "time": (),
    "confidence": (),
    "box": (4,),
    "position": (3,),
    "embedding": ("d",),
}


class FolderFrames(Sequence[np.ndarray]):
    """Image files as a sequence of RGB frames, each decoded when it is asked for.

    Args:
        paths: One image file a frame, in order.

    Raises:
        FileNotFoundError: A file is missing.
        ValueError: A file does not decode as an image (at the time it is read).
    """

    def __init__(self, paths: Sequence[str | Path]) -> None:
        self.paths = [Path(path) for path in paths]
        for path in self.paths:
            if not path.is_file():
                raise FileNotFoundError(f"frame {path} does not exist")

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: Any) -> Any:
        cv2 = require("cv2", extra="vision")

        data = np.fromfile(self.paths[index], dtype=np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
        if image is None:
            raise ValueError(f"frame {self.paths[index]} does not decode as an image")
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


class VideoFrames(Sequence[np.ndarray]):
    """A video file as a sequence of RGB frames, decoded forwards and never sought.

    Seeking is not frame exact in most containers, so a step back starts over from the first
    frame. A pass in frame order decodes each frame once.

    Args:
        path: Video file that OpenCV can read.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It does not open as a video, or a frame does not decode.
    """

    def __init__(self, path: str | Path) -> None:
        cv2 = require("cv2", extra="vision")

        self.path = Path(path)
        if not self.path.is_file():
            raise FileNotFoundError(f"video {path} does not exist")
        self._capture = cv2.VideoCapture(str(self.path))
        if not self._capture.isOpened():
            raise ValueError(f"{path} does not open as a video")
        self._length = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self._position = 0

    def __reduce__(self) -> Any:
        return VideoFrames, (self.path,)  # an open video cannot be pickled: it is opened anew

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, index: Any) -> Any:
        cv2 = require("cv2", extra="vision")

        if not 0 <= index < self._length:
            raise IndexError(f"frame {index} of {self.path}, which has {self._length}")
        if index < self._position:
            self._capture.release()
            self._capture = cv2.VideoCapture(str(self.path))
            self._position = 0
        good = True
        while good and self._position < index:
            good = self._capture.grab()
            self._position += 1
        good, image = self._capture.read() if good else (False, None)
        self._position += 1
        if not good or image is None:
            raise ValueError(f"frame {index} of video {self.path} does not decode")
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


class Images:
    """The pixels of each observation, cropped lazily from the frame that it was seen in.

    Args:
        frames: Any sequence of (height, width, 3) uint8 RGB frames: :class:`FolderFrames`,
            :class:`VideoFrames`, or a list of arrays.
        frame: (m,) which of the frames each observation was seen in, counting from 0.
        box: (m, 4) x1 y1 x2 y2 in pixels; None for whole frames. Crops are clipped to the frame
            and never empty: a box outside of it gives the nearest pixel.
    """

    # Sequence[Any], as a type checker at run time would decode a frame to see what it is.
    def __init__(self, frames: Sequence[Any], frame: Any, box: Any = None) -> None:
        self.frames = frames
        self.frame_index = np.asarray(frame, dtype=np.int64)
        self.box = None if box is None else np.asarray(box, dtype=np.float64)
        self._cached: tuple[int, np.ndarray] | None = None
        if self.frame_index.ndim != 1:
            raise ValueError(f"frame: expected shape (m,), got {self.frame_index.shape}")
        if self.box is not None and self.box.shape != (len(self), 4):
            raise ValueError(f"box: expected shape ({len(self)}, 4), got {self.box.shape}")
        if len(self) and not (self.frame_index.min() >= 0 and self.frame_index.max() < len(frames)):
            raise ValueError(
                f"frame: expected values in 0..{len(frames) - 1}, "
                f"got {self.frame_index.min()}..{self.frame_index.max()}"
            )

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_cached": None}  # the decoded frame can be had again

    def __len__(self) -> int:
        return len(self.frame_index)

    def frame(self, i: int) -> UInt8[np.ndarray, "height width 3"]:
        """The whole frame of observation i, not to be written to; the latest one is kept."""
        index = int(self.frame_index[i])
        if self._cached is None or self._cached[0] != index:
            self._cached = (index, self.frames[index])
        return self._cached[1]

    def crop(self, i: int) -> UInt8[np.ndarray, "height width 3"]:
        """The pixels inside the box of observation i, RGB: a copy, which holds no frame alive."""
        frame = self.frame(i)
        if self.box is None:
            return frame.copy()
        height, width = frame.shape[:2]
        x1, y1, x2, y2 = np.nan_to_num(self.box[i])
        left = int(np.clip(np.floor(x1), 0, width - 1))
        top = int(np.clip(np.floor(y1), 0, height - 1))
        right = int(np.clip(np.ceil(x2), left + 1, width))
        bottom = int(np.clip(np.ceil(y2), top + 1, height))
        return frame[top:bottom, left:right].copy()

    def crops(self) -> Iterator[tuple[int, UInt8[np.ndarray, "height width 3"]]]:
        """All (i, crop) in frame order: every frame is decoded once, one is held at a time."""
        for i in np.argsort(self.frame_index, kind="stable"):
            yield int(i), self.crop(int(i))

    def select(self, index: np.ndarray) -> Images:
        """The same frames, for some of the observations."""
        box = None if self.box is None else self.box[index]
        return Images(self.frames, self.frame_index[index], box)

    def _reference(self) -> str:
        if isinstance(self.frames, FolderFrames):
            return json.dumps({"folder": [str(path.resolve()) for path in self.frames.paths]})
        if isinstance(self.frames, VideoFrames):
            return json.dumps({"video": str(self.frames.path.resolve())})
        raise ValueError(
            "images: only frames from files can be saved (as paths), and these are "
            f"{type(self.frames).__name__}; save dataclasses.replace(observations, images=None)"
        )


@dataclass(frozen=True, eq=False)
class Observations:
    """m things seen, as a frozen struct of arrays.

    Args:
        view: (m,) int64, the set of the paper (usually a frame, or a camera and a frame). Objects
            within one view are distinct. A negative view is no view: such an observation is
            distinct from nothing (a gallery of single images).
        features: What was measured, each with leading dimension m. A row of NaN means "not
            measured here". Standard keys: ``time`` float64 seconds; ``frame``, ``camera`` int64;
            ``box`` (m, 4) float32 x1 y1 x2 y2 pixels; ``position`` (m, 3) float32 metres, world
            frame; ``confidence`` (m,); ``embedding`` (m, d); ``identity`` int64 truth, -1 where
            there is none. Any further key is allowed.
        images: Pixels, read lazily.

    Raises:
        ValueError: An argument has the wrong shape or type; the message names it.
    """

    view: Tensor
    features: Mapping[str, Tensor] = field(default_factory=dict)
    images: Images | None = None

    def __post_init__(self) -> None:
        view = integers("view", self.view)
        object.__setattr__(self, "view", view)
        features = {}
        for name, value in self.features.items():
            features[name] = _feature(name, value, view)
        object.__setattr__(self, "features", MappingProxyType(features))
        if self.images is not None and len(self.images) != len(view):
            raise ValueError(
                f"images: expected one for each of {len(view)} observations, got {len(self.images)}"
            )

    def __reduce__(self) -> Any:
        # without this the read-only mapping of features could be neither pickled nor copied
        return type(self), (self.view, dict(self.features), self.images)

    def __repr__(self) -> str:
        features = [f"features: {', '.join(self.features)}"] if self.features else []
        images = ["images"] if self.images is not None else []
        parts = [count_views(self.view), *features, *images, str(self.device)]
        return f"Observations({'; '.join(parts)})"

    def __len__(self) -> int:
        return len(self.view)

    @property
    def camera(self) -> Int64[Tensor, " m"]:
        """(m,) int64, the feature ``camera``; 0 throughout, the one camera, where there is none."""
        camera = self.features.get("camera")
        return torch.zeros_like(self.view) if camera is None else camera

    def __getitem__(self, name: str) -> Tensor:
        """Feature by name; KeyError lists those that there are."""
        if name not in self.features:
            have = ", ".join(self.features) or "none"
            raise KeyError(f"observations have no feature {name!r}; features: {have}")
        return self.features[name]

    @property
    def device(self) -> torch.device:
        return self.view.device

    def select(self, index: Tensor) -> Observations:
        """Some of the observations: a mask (m,) bool, or indices in the order wanted."""
        index = torch.as_tensor(index, device=self.device)
        if index.dtype == torch.bool and len(self):
            if index.shape != self.view.shape:
                raise ValueError(
                    f"index: expected a mask of shape ({len(self)},), got {tuple(index.shape)}"
                )
            index = index.nonzero()[:, 0]
        index = integers("index", index)
        features = {name: value[index] for name, value in self.features.items()}
        images = None if self.images is None else self.images.select(index.cpu().numpy())
        return Observations(self.view[index], features, images)

    def with_features(self, **features: Tensor) -> Observations:
        """The same observations with features added or replaced."""
        return replace(self, features={**self.features, **features})

    def to(self, device: torch.device | str) -> Observations:
        """The same observations with all tensors on a device (pixels stay where they are)."""
        features = {name: value.to(device) for name, value in self.features.items()}
        return Observations(self.view.to(device), features, self.images)

    def save(self, path: str | Path) -> None:
        """Write one npz: ``view``, a ``feature/<key>`` for each feature, and, for images in files,
        ``images`` (their paths as JSON), ``images/frame`` and ``images/box``.

        Raises:
            ValueError: The frames are in memory and not in files.
        """
        arrays: dict[str, Any] = {"format": np.array(FORMAT), "view": self.view.cpu().numpy()}
        for name, value in self.features.items():
            arrays[f"feature/{name}"] = value.detach().cpu().numpy()
        if self.images is not None:
            arrays["images"] = np.array(self.images._reference())
            arrays["images/frame"] = self.images.frame_index
            if self.images.box is not None:
                arrays["images/box"] = self.images.box
        save_npz(path, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Observations:
        """Read what :meth:`save` wrote."""
        arrays = load_npz(path, FORMAT)
        features = {
            name.removeprefix("feature/"): torch.from_numpy(array)
            for name, array in arrays.items()
            if name.startswith("feature/")
        }
        images = None
        if "images" in arrays:
            reference = json.loads(str(arrays["images"]))
            frames: Sequence[np.ndarray] = (
                VideoFrames(reference["video"])
                if "video" in reference
                else FolderFrames(reference["folder"])
            )
            images = Images(frames, arrays["images/frame"], arrays.get("images/box"))
        return cls(torch.from_numpy(arrays["view"]), features, images)


def distinct_views(view: Int64[Tensor, " m"]) -> Int64[Tensor, " m"]:
    """Views as consecutive numbers 0.., a view of its own for each observation that has none."""
    lonely = view < 0
    fresh = torch.cumsum(lonely, 0) + view.max().clamp(min=0) if len(view) else view
    return torch.unique(torch.where(lonely, fresh, view), return_inverse=True)[1]


def count_views(view: Int64[Tensor, " m"]) -> str:
    """How many observations there are, in how many views, in words."""
    views = len(torch.unique(view[view >= 0]))
    alone = int((view < 0).sum())
    without = f", {alone} of them without a view" if alone else ""
    return f"{len(view)} observations in {views} views{without}"


def integers(name: str, value: Any) -> Tensor:
    """A one-dimensional int64 tensor, or a ValueError that names the argument."""
    tensor = _tensor(name, value)
    if tensor.numel() == 0 and tensor.ndim == 1:
        return tensor.to(torch.int64)
    if tensor.ndim != 1 or tensor.dtype.is_floating_point or tensor.dtype == torch.bool:
        raise ValueError(
            f"{name}: expected integers of shape (m,), "
            f"got {tensor.dtype} of shape {tuple(tensor.shape)}"
        )
    return tensor.to(torch.int64)


def _tensor(name: str, value: Any) -> Tensor:
    try:
        return torch.as_tensor(value)
    except (TypeError, ValueError, RuntimeError) as error:
        kind = type(value).__name__
        raise ValueError(f"{name}: expected numbers, got {kind}: {error}") from error


def _feature(key: str, value: Any, view: Tensor) -> Tensor:
    name, m = f"features[{key!r}]", len(view)
    tensor = _tensor(name, value)
    shape = tuple(tensor.shape)
    if not shape or shape[0] != m:
        raise ValueError(f"{name}: expected leading dimension {m}, got shape {shape}")
    if tensor.device != view.device:
        raise ValueError(f"{name}: expected the device of view, {view.device}, got {tensor.device}")
    if key in INT_FEATURES:
        return integers(name, tensor)
    expected = (m, *SHAPES.get(key, shape[1:]))
    if len(shape) != len(expected) or any(
        size not in ("d", found) for size, found in zip(expected, shape, strict=True)
    ):
        wanted = str(expected).replace("'", "")
        raise ValueError(f"{name}: expected shape {wanted}, got {shape}")
    return tensor.to(FLOAT_FEATURES.get(key, tensor.dtype))
