"""The colours of several cameras brought to common ground, without labels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int64, UInt8

LEVELS = 256
QUANTILES = 1001
FOCUS = 0.12
"""Standard deviation of the weight across an image, as a share of its width."""


class BalancedFrames(Sequence[np.ndarray]):
    """Frames of several cameras, each channel of each camera mapped by a brightness transfer.

    Args:
        frames: RGB frames.
        camera: (m,) integers, the camera of each frame.
    """

    # Sequence[Any], as a type checker at run time would decode a frame to see what it is.
    def __init__(self, frames: Sequence[Any], camera: np.ndarray) -> None:
        self.frames = frames
        self.camera = np.unique(camera, return_inverse=True)[1].reshape(len(frames))
        self.tables = brightness_transfer(channel_histograms(frames, self.camera))

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: Any) -> Any:
        table = self.tables[self.camera[index]]
        frame = self.frames[index]
        return np.stack([table[k][frame[..., k]] for k in range(3)], axis=-1)


def channel_histograms(
    frames: Sequence[Any], camera: Int64[np.ndarray, " m"]
) -> Float[np.ndarray, "cameras 3 levels"]:
    """How often each camera's channels have each level, columns near the middle counting most.

    In a crop the object is in the middle, and the ground at the sides, which is another at each
    camera.
    """
    found = np.zeros((int(camera.max(initial=-1)) + 1, 3, LEVELS))
    for own, frame in zip(camera, frames, strict=True):
        height, width = frame.shape[:2]
        across = np.exp(-(((np.arange(width) + 0.5) / width - 0.5) ** 2) / (2 * FOCUS**2))
        weight = np.broadcast_to(across, (height, width)).ravel()
        for k in range(3):
            found[own, k] += np.bincount(frame[..., k].ravel(), weight, LEVELS)
    return found


def brightness_transfer(
    histograms: Float[np.ndarray, "cameras 3 levels"],
) -> UInt8[np.ndarray, "cameras 3 levels"]:
    """The level that takes the place of each, for each camera and channel.

    With F_c the distribution of a channel at camera c, level v becomes the mean over the cameras k
    of the quantiles F_k⁻¹(F_c(v)): cumulative brightness transfer functions (Prosser, Gong and
    Xiang 2008), not from one camera to another but from each to the barycentre of all. It rests on
    the cameras having seen the same objects on the whole.
    """
    levels, quantiles = np.arange(LEVELS), np.linspace(0, 1, QUANTILES)
    tables = np.zeros(histograms.shape, np.uint8)
    for k in range(histograms.shape[1]):
        share = histograms[:, k] / histograms[:, k].sum(1, keepdims=True)
        middle = np.cumsum(share, 1) - share / 2
        inverse = [np.interp(quantiles, row, levels) for row in middle]
        common = np.sum(inverse, axis=0) / max(len(inverse), 1)
        for camera, row in enumerate(middle):
            level = np.maximum.accumulate(np.interp(row, quantiles, common))
            tables[camera, k] = np.round(level).clip(0, LEVELS - 1)
    return tables
