"""Extraction of SIFT descriptors: keypoints in crops by OpenCV or kornia, and at given points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, Int64, UInt8
from torch import Tensor, nn

from mixer_torch.extras import require
from mixer_torch.observations import Images

LARGEST_ZOOM = 4
"""Convention: beyond it, interpolation adds keypoints that are no texture."""


class OpenCVKeypoints:
    """SIFT of OpenCV, on the CPU.

    Args:
        limit: Keypoints kept, the strongest.
        contrast: Contrast threshold: lower finds more and weaker ones.
        root: RootSIFT instead of SIFT: square roots of descriptors of unit sum, whose Euclidean
            distance is the Hellinger distance (Arandjelovic and Zisserman, CVPR 2012).
    """

    def __init__(self, limit: int, contrast: float, root: bool) -> None:
        cv2 = require("cv2", extra="vision")
        self.limit = limit
        self.root = root
        self._sift = cv2.SIFT_create(nfeatures=limit, contrastThreshold=contrast)

    def __call__(self, image: UInt8[np.ndarray, "height width"]) -> Float[Tensor, "n 128"]:
        """Unit descriptors of a grey image, the strongest keypoint first."""
        keypoints, descriptors = self._sift.detectAndCompute(image, None)
        if descriptors is None:
            return torch.zeros(0, 128)
        order = np.argsort([-point.response for point in keypoints], kind="stable")[: self.limit]
        return unit(torch.from_numpy(descriptors[order]), self.root)


class KorniaKeypoints:
    """SIFT of kornia, on a device.

    Args:
        limit: Keypoints kept, the strongest.
        contrast: Least response of the detector: lower finds more and weaker ones.
        root: RootSIFT instead of SIFT.
        device: Where to work.
    """

    def __init__(self, limit: int, contrast: float, root: bool, device: torch.device) -> None:
        self._kornia = require("kornia.feature", extra="vision")
        self.limit = limit
        self.contrast = contrast
        self.device = device
        sift = self._kornia.SIFTFeatureScaleSpace(limit, rootsift=root, device=device)
        self._sift: nn.Module = sift.eval()

    @torch.no_grad()
    def __call__(self, image: UInt8[np.ndarray, "height width"]) -> Float[Tensor, "n 128"]:
        """Unit descriptors of a grey image, the strongest keypoint first."""
        pixels = torch.from_numpy(np.ascontiguousarray(image)).to(self.device).float() / 255
        frames, responses, descriptors = self._sift(pixels[None, None])
        keep = self._kornia.laf_is_filled(frames)[0] & (responses[0] >= self.contrast)
        return unit(descriptors[0, keep], root=False)


def keypoints_of(
    images: Images | None, extract: Callable[[np.ndarray], Tensor], enlarge: int
) -> tuple[Float[Tensor, "m K 128"], Int64[Tensor, " m"]]:
    """Keypoints of all crops, padded to the largest number there is.

    Args:
        images: m crops.
        extract: Descriptors of a grey image, such as :class:`OpenCVKeypoints`.
        enlarge: Crops whose longer side has fewer pixels are enlarged to it, up to four times.

    Returns:
        (m, K, 128) unit descriptors, and (m,) how many of the K each has.
    """
    found = [torch.zeros(0, 128)] * (0 if images is None else len(images))
    for i, crop in images.crops() if images is not None else ():
        found[i] = extract(_grey(crop, enlarge))
    if not found:
        return torch.zeros(0, 0, 128), torch.zeros(0, dtype=torch.int64)
    count = torch.tensor([len(descriptors) for descriptors in found], device=found[0].device)
    return nn.utils.rnn.pad_sequence(found, batch_first=True), count


def _grey(
    crop: UInt8[np.ndarray, "height width 3"], enlarge: int
) -> UInt8[np.ndarray, "height2 width2"]:
    cv2 = require("cv2", extra="vision")
    grey = cv2.cvtColor(np.ascontiguousarray(crop), cv2.COLOR_RGB2GRAY)
    zoom = min(enlarge / max(grey.shape), LARGEST_ZOOM)
    if zoom <= 1:
        return grey
    size = (max(round(grey.shape[1] * zoom), 1), max(round(grey.shape[0] * zoom), 1))
    return cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC)


def unit(descriptors: Float[Tensor, "*n d"], root: bool) -> Float[Tensor, "*n d"]:
    """Descriptors of unit Euclidean length: RootSIFT if ``root``."""
    if root:
        descriptors = nn.functional.normalize(descriptors, p=1, dim=-1).clamp(min=0).sqrt()
    return nn.functional.normalize(descriptors, dim=-1)


def points_of(
    images: Images | None, point: np.ndarray, size: float, root: bool
) -> Float[Tensor, "m 128"]:
    """Upright descriptors at given points of the whole frames; NaN where the point is NaN.

    Args:
        images: m frames.
        point: (m, 2) x y in pixels of the frame.
        size: Diameter of the neighbourhood as OpenCV counts it, pixels.
        root: RootSIFT instead of SIFT.
    """
    cv2 = require("cv2", extra="vision")
    sift = cv2.SIFT_create()
    found = torch.full((len(point), 128), torch.nan)
    frame = np.zeros(0, dtype=np.int64) if images is None else images.frame_index
    known = np.isfinite(point).all(1)
    for index in np.unique(frame[known]):
        rows = np.flatnonzero(known & (frame == index))
        pixels = images.frame(int(rows[0]))  # type: ignore[union-attr]
        grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        places = [cv2.KeyPoint(float(x), float(y), size, 0.0) for x, y in point[rows]]
        kept, descriptors = sift.compute(grey, places)
        if len(kept) != len(rows):
            raise ValueError(f"point: OpenCV describes {len(kept)} of {len(rows)} in frame {index}")
        found[torch.from_numpy(rows)] = unit(torch.from_numpy(descriptors), root)
    return found


def distance_of(similarity: Tensor) -> Tensor:
    """Euclidean distance of unit vectors from their inner product."""
    return (2 - 2 * similarity).clamp(min=1e-12).sqrt()
