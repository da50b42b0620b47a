"""Tracks: where each object was, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64

from mixer_torch.observations import Observations, integers

INTEGERS = ("frame", "identity", "camera", "observation")
"""The arrays of integers, one of each row."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """n boxes of tracks, as a frozen struct of arrays in order of frame, identity and camera.

    What is given may be in any order, and is copied. An identity has one box at most in a frame
    of a camera, and is the same object in all cameras.

    Args:
        frame: (n,) int64, as the sequence numbers its frames.
        identity: (n,) int64, 1 or more.
        box: (n, 4) float64 x1 y1 x2 y2 pixels, finite.
        confidence: (n,) float64, NaN where it is not known; 1 throughout if None.
        camera: (n,) int64; 0 throughout, the one camera, if None.
        observation: (n,) int64, the index of the observation that the box is of, -1 where it is of
            none (interpolated, or read from a file); -1 throughout if None.

    Raises:
        ValueError: An array has the wrong shape, type or values, or an identity has two boxes in
            one frame of a camera; the message names the argument.
    """

    frame: Any
    identity: Any
    box: Any
    confidence: Any = None
    camera: Any = None
    observation: Any = None

    def __post_init__(self) -> None:
        arrays = {"frame": _array("frame", self.frame, (None,))}
        n = len(arrays["frame"])
        fill = {"confidence": np.ones(n), "camera": np.zeros(n, int), "observation": np.full(n, -1)}
        for name in ("identity", "box", "confidence", "camera", "observation"):
            value = fill.get(name) if getattr(self, name) is None else getattr(self, name)
            arrays[name] = _array(name, value, (n, 4) if name == "box" else (n,))
        order = np.lexsort((arrays["camera"], arrays["identity"], arrays["frame"]))
        for name, value in arrays.items():
            object.__setattr__(self, name, value[order])
        self._check()

    def _check(self) -> None:
        if len(self) and self.identity.min() < 1:
            raise ValueError(f"identity: expected 1 or more, got {self.identity.min()}")
        finite = np.isfinite(self.box).all(1)
        if not finite.all():
            raise ValueError(f"box: expected finite numbers, got {self.box[~finite][0]}")
        place = np.stack([self.frame, self.identity, self.camera])
        again = np.flatnonzero((place[:, 1:] == place[:, :-1]).all(0))
        if len(again):
            frame, identity, camera = place[:, again[0]]
            raise ValueError(
                f"identity: expected one box in a frame of a camera, got two of {identity} "
                f"in frame {frame} of camera {camera}"
            )

    def __len__(self) -> int:
        return len(self.frame)

    @classmethod
    def from_labels(cls, observations: Observations, labels: Any) -> Tracks:
        """The tracks that an association's labels make of observations: identity = label + 1.

        Observations of a negative label are of no track, and those whose box was not measured
        (not finite) are left out.

        Args:
            observations: With ``frame`` and ``box``; ``confidence`` and ``camera`` are kept where
                they are there.
            labels: (m,) integers.

        Raises:
            KeyError: There is no feature ``frame`` or ``box``.
            ValueError: Labels are not one integer for each observation, or two observations of a
                label are in one frame of a camera.
        """
        label = integers("labels", labels).cpu().numpy()
        if len(label) != len(observations):
            raise ValueError(f"labels: expected {len(observations)}, got {len(label)}")
        box = observations["box"].detach().double().cpu().numpy()
        row = np.flatnonzero((label >= 0) & np.isfinite(box).all(1))
        kept = {
            name: observations[name].detach().cpu().numpy()[row]
            for name in ("confidence", "camera")
            if name in observations.features
        }
        frame = observations["frame"].cpu().numpy()[row]
        return cls(frame, label[row] + 1, box[row], observation=row, **kept)

    def check_one_camera(self) -> None:
        """ValueError where the boxes are of several cameras."""
        cameras = np.unique(self.camera)
        if len(cameras) > 1:
            raise ValueError(
                f"tracks: expected one camera, got {', '.join(map(str, cameras))}; "
                f"select(tracks.camera == {cameras[0]}) first"
            )

    def select(self, mask: Any) -> Tracks:
        """Some of the boxes: a mask (n,) bool, or indices."""
        index = np.asarray(mask)
        if index.dtype == bool and index.shape != (len(self),):
            raise ValueError(f"mask: expected shape ({len(self)},), got {index.shape}")
        if not index.size:
            index = index.astype(np.int64)
        names = ("frame", "identity", "box", "confidence", "camera", "observation")
        return Tracks(*(getattr(self, name)[index] for name in names))


def from_one(identity: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Identities raised by 1 where one of them is 0."""
    return identity + int(identity.min(initial=1) == 0)


def _array(name: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """A float64 or int64 array of a shape, or a ValueError that names the argument."""
    whole = name in INTEGERS
    if isinstance(value, torch.Tensor):
        value = value.detach().cpu().numpy()
    try:
        array = np.asarray(value)
        kind = array.dtype.kind if array.size else "i"
        if kind not in ("iu" if whole else "iuf"):
            raise TypeError(f"got {array.dtype}")
        array = array.astype(np.int64 if whole else np.float64)
    except (TypeError, ValueError) as error:
        expected = "integers" if whole else "numbers"
        raise ValueError(f"{name}: expected {expected}: {error}") from error
    if not array.size and shape[0] in (0, None):
        array = array.reshape(0, *shape[1:])
    if array.ndim != len(shape) or any(
        size not in (None, found) for size, found in zip(shape, array.shape, strict=True)
    ):
        wanted = str(shape).replace("None", "n")
        raise ValueError(f"{name}: expected shape {wanted}, got {array.shape}")
    return array
