"""Appearance as a vector: a learned network over crops, or vectors that were computed elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn.functional import normalize

from mixer_torch.extras import require
from mixer_torch.io.weights import load_weights, read_weights, write_weights
from mixer_torch.observations import Images, Observations
from mixer_torch.scorers.curves import Logistic
from mixer_torch.scorers.neighbours import jaccard, reciprocal_encoding
from mixer_torch.scoring import Calibrator, Scorer

FORMAT = "mixer-torch embedding 2"
BATCH = 128
"""Crops embedded at a time; a convention."""
FEW = 5
"""Zero vectors that are averaged into a camera's mean: shrinkage, so that a few vectors that are
all alike are not centred away. A convention."""
COSINE = 0.3
"""Share of the cosine in the evidence, beside that of the neighbours (Zhong et al. 2017)."""
MEAN, STD = 0.45, 0.25
"""About those of the values of ImageNet, over all channels."""


class EmbeddingNetwork(nn.Module):
    """A compact convolutional network from crops to unit vectors.

    Four blocks of convolution, normalisation and ReLU. The first has instance normalisation, which
    removes much of an image's illumination (Pan et al. 2018); features are pooled in horizontal
    strips, so that shirt and trousers do not mix (Sun et al. 2018).

    Args:
        dimension: Of the vectors.
        width: Channels of the first block; later ones have 2, 4 and 6 times as many.
        strips: Horizontal strips.
    """

    def __init__(self, dimension: int = 128, width: int = 24, strips: int = 8) -> None:
        super().__init__()
        self.settings = {"dimension": dimension, "width": width, "strips": strips}
        channels = [3, width, 2 * width, 4 * width, 6 * width]
        blocks: list[nn.Module] = []
        for k, (before, after) in enumerate(pairwise(channels)):
            stride = 2 if k < 3 else 1
            blocks += [
                nn.Conv2d(before, after, 3, stride, 1, bias=False),
                nn.InstanceNorm2d(after, affine=True) if k == 0 else nn.BatchNorm2d(after),
                nn.ReLU(inplace=True),
            ]
        self.features = nn.Sequential(*blocks)
        self.pool = nn.AdaptiveAvgPool2d((strips, 1))
        self.head = nn.Linear(channels[-1] * strips, dimension)

    def forward(self, crops: Float[Tensor, "B 3 height width"]) -> Float[Tensor, "B d"]:
        """Unit vectors of RGB crops with values in [0, 1]."""
        pooled = self.pool(self.features((crops - MEAN) / STD)).flatten(1)
        return normalize(self.head(pooled), dim=1)


class Embedding(Scorer):
    """Same appearance, same object: the cosine of two appearance vectors.

    With ``reciprocal`` the evidence is 0.3 cosine + 0.7 Jaccard similarity of the k-reciprocal
    neighbours, which is re-ranking (Zhong et al. 2017) and takes time and memory of m².

    Args:
        path: Where the vectors come from: a ``.safetensors`` file that ``mixer-train`` wrote, or a
            network of your own as TorchScript (``.pt``, ``.ts``) or ONNX (``.onnx``), which takes
            (B, 3, height, width) RGB in [0, 1] and returns (B, d). If None, the feature is used.
        feature: Vectors that were computed elsewhere.
        height: Of the crops as resized for a network, pixels.
        width: Of the crops as resized for a network, pixels.
        mirror: Whether to average the vectors of each crop and its mirror image.
        centre: Whether to subtract from each vector the mean of its camera's, which removes what
            all crops of a camera have in common: its light, its background. For cameras that saw
            several objects each; needs the feature ``camera``.
        reciprocal: k of the k-reciprocal neighbours: about as many as there are observations of an
            object; 0 for the cosine alone.
        slope: Log likelihood ratio gained by a unit of cosine, nats, set by hand.
        midpoint: Cosine at which the score is 0.5, set by hand.
        calibrator: Takes the place of the one set by hand.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is of no known kind, a size is not positive, or reciprocal is negative.
    """

    chunk = 1 << 14

    def __init__(
        self,
        path: str | Path | None = None,
        feature: str = "embedding",
        height: int = 128,
        width: int = 48,
        mirror: bool = False,
        centre: bool = False,
        reciprocal: int = 0,
        slope: float = 8.0,
        midpoint: float = 0.5,
        calibrator: Calibrator | None = None,
    ) -> None:
        super().__init__(calibrator or Logistic(slope, midpoint, 0.02, 0.98))
        if height < 1 or width < 1:
            raise ValueError(f"height, width: expected integers >= 1, got {height}, {width}")
        if reciprocal < 0:
            raise ValueError(f"reciprocal: expected an integer >= 0, got {reciprocal}")
        self.path = path
        self.reciprocal = reciprocal
        self.height, self.width = height, width
        self.mirror, self.centre = mirror, centre
        self.feature = feature
        self.needs = (feature if path is None else "images", *(["camera"] if centre else []))
        self.network = None if path is None else load_embedder(Path(path))

    def describe(self, observations: Observations) -> Tensor | tuple[Tensor, Tensor]:
        """(m, d) unit vectors, NaN where there is none; with ``reciprocal``, encodings too."""
        if self.network is None:
            value = observations[self.feature].flatten(1)
            value = value if value.is_floating_point() else value.float()
            vectors = normalize(value, dim=1)
        else:
            crops = crops_of(observations.images, (self.height, self.width))
            vectors = embed(self.network, crops, self.mirror, observations.device)
        vectors = centred(vectors, observations["camera"]) if self.centre else vectors
        if not self.reciprocal:
            return vectors
        return vectors, reciprocal_encoding(vectors, self.reciprocal)

    def compare(self, description: Tensor | tuple[Tensor, Tensor], pairs: Tensor) -> Tensor:
        if isinstance(description, Tensor):
            return (description[pairs[0]] * description[pairs[1]]).sum(1)
        vectors, encoding = description
        cosine = (vectors[pairs[0]] * vectors[pairs[1]]).sum(1)
        return COSINE * cosine + (1 - COSINE) * jaccard(encoding, pairs)


def embed(
    network: Callable[[Tensor], Tensor],
    crops: Float[Tensor, "m 3 height width"],
    mirror: bool = False,
    device: torch.device | str = "cpu",
) -> Float[Tensor, "m d"]:
    """Unit vectors of crops, in batches; with ``mirror``, means with those of the mirror images."""
    found = []
    with torch.no_grad():
        for part in crops.split(BATCH) if len(crops) else ():
            vectors = normalize(network(part.to(device)).float(), dim=1)
            if mirror:
                vectors = vectors + normalize(network(part.flip(3).to(device)).float(), dim=1)
            found.append(vectors)
    return normalize(torch.cat(found).to(device), dim=1) if found else torch.zeros(0, 1).to(device)


def centred(vectors: Float[Tensor, "m d"], camera: Int64[Tensor, " m"]) -> Float[Tensor, "m d"]:
    """Unit vectors less the mean of their camera's, shrunk by :data:`FEW` zero vectors."""
    found = vectors.clone()
    for own in torch.unique(camera):
        known = (camera == own) & vectors.isfinite().all(1)
        found[known] -= vectors[known].sum(0) / (int(known.sum()) + FEW)
    return normalize(found, dim=1)


def crops_of(images: Images | None, size: Sequence[int]) -> Float[Tensor, "m 3 height width"]:
    """All crops, resized to (height, width), with values in [0, 1]."""
    cv2 = require("cv2", extra="vision")

    height, width = size
    found = torch.zeros(0 if images is None else len(images), 3, height, width)
    for i, crop in images.crops() if images is not None else ():
        resized = cv2.resize(np.ascontiguousarray(crop), (width, height))
        found[i] = torch.from_numpy(resized).permute(2, 0, 1).float() / 255
    return found


def load_embedder(path: Path) -> Callable[[Tensor], Tensor]:
    """A function from crops to vectors, of the kind that the suffix of the file says."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not found")
    if path.suffix == ".safetensors":
        tensors, settings = read_weights(path, FORMAT)
        sizes = {key: int(settings[key]) for key in ("dimension", "width", "strips")}
        network = EmbeddingNetwork(**sizes)
        load_weights(path, network, tensors)
        return network.eval().requires_grad_(False)
    if path.suffix in (".pt", ".ts"):
        try:
            return torch.jit.load(path, map_location="cpu").eval()
        except RuntimeError as error:
            raise ValueError(f"{path} is not a readable TorchScript file: {error}") from error
    if path.suffix == ".onnx":
        return _OnnxNetwork(path)
    raise ValueError(f"path: expected .safetensors, .pt, .ts or .onnx, got {path}")


class _OnnxNetwork:
    """An ONNX file run on the CPU: by OpenCV, or, where that cannot read it, by onnxruntime."""

    def __init__(self, path: Path) -> None:
        cv2 = require("cv2", extra="vision")
        try:
            network = cv2.dnn.readNetFromONNX(str(path))
        except cv2.error as error:
            self._run = _run_by_onnxruntime(path, error)
        else:
            self._run = partial(_run_by_opencv, network)

    def __call__(self, crops: Tensor) -> Tensor:
        return torch.from_numpy(self._run(crops.cpu().numpy()))


def _run_by_opencv(network: Any, crops: np.ndarray) -> np.ndarray:
    network.setInput(crops)
    return network.forward().copy()


def _run_by_onnxruntime(path: Path, error: Exception) -> Callable[[np.ndarray], np.ndarray]:
    """A function of crops; ValueError where onnxruntime does not read the file either.

    ``error`` is OpenCV's.
    """
    try:
        from onnxruntime import InferenceSession
    except ImportError:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{path} is not an ONNX file that OpenCV reads ({reason}); "
            "if it is good, install onnxruntime, which reads more: pip install onnxruntime"
        ) from error
    try:
        session = InferenceSession(str(path), providers=["CPUExecutionProvider"])
    except Exception as refused:  # onnxruntime's errors have no base of their own
        raise ValueError(f"{path} is not a readable ONNX file: {refused}") from refused
    name = session.get_inputs()[0].name
    return lambda crops: session.run(None, {name: crops})[0]


def save_embedding(path: str | Path, network: EmbeddingNetwork) -> None:
    """Write a safetensors file that :class:`Embedding` takes."""
    settings = {key: str(value) for key, value in network.settings.items()}
    write_weights(path, FORMAT, network, settings)
