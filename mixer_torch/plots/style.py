"""What all pictures share: a colour for each cluster, what the truth says of it, how to save."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int64

from mixer_torch.extras import require
from mixer_torch.observations import Observations

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HUES = (45.0, 345.0)
"""Degrees of OKLCh hue in use. Reds are left out: they mark what is wrong."""
LIGHTNESSES = (0.5, 0.8)
HUE_STEP, LIGHTNESS_STEP = 0.618034, 0.345
"""Steps from one label to the next, as shares of the ranges above. The first is the golden ratio,
which spreads any number of labels evenly; the second was chosen by search, so that no two of the
first 40 labels are nearer than 0.06 in OKLab."""
CHROMA = 0.17
WRONG = (0.86, 0.06, 0.10)
MISSED = (0.98, 0.72, 0.20)
FADED = (0.62, 0.62, 0.62)
INK = (0.13, 0.15, 0.19)


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    figure.savefig(path, format="png", facecolor="white")


def new_figure(width: float, height: float, dpi: float = 100) -> Figure:
    """An empty figure, inches. It is made without pyplot, so nothing global is touched.

    Raises:
        ImportError: Matplotlib is not installed.
    """
    return require("matplotlib.figure", extra="plots").Figure(figsize=(width, height), dpi=dpi)


def blank_figure(text: str) -> Figure:
    """A picture that says why there is nothing to see."""
    figure = new_figure(6, 2)
    figure.text(0.5, 0.5, text, ha="center", va="center", color=INK, fontsize=12)
    return figure


def colors(labels: Int64[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """SRGB in 0..1 of each label >= 0, far from those of the labels before it.

    The colours are laid out in the perceptual space OKLCh (Ottosson 2020).
    """
    labels = np.asarray(labels)
    hue = np.radians(HUES[0] + (labels * HUE_STEP % 1) * (HUES[1] - HUES[0]))
    step = (0.5 + labels * LIGHTNESS_STEP) % 1
    lightness = LIGHTNESSES[0] + step * (LIGHTNESSES[1] - LIGHTNESSES[0])
    return _oklab_to_srgb(lightness, CHROMA * np.cos(hue), CHROMA * np.sin(hue))


def by_size(labels: Int64[np.ndarray, " m"]) -> Int64[np.ndarray, " k"]:
    """The labels that there are, the largest cluster first, equal ones by label."""
    values, size = np.unique(labels, return_counts=True)
    return values[np.lexsort((values, -size))]


def groups(labels: Int64[np.ndarray, " m"]) -> list[np.ndarray]:
    """The members of each cluster, ascending, the clusters in the order of :func:`by_size`."""
    if not len(labels):
        return []
    order = np.argsort(labels, kind="stable")
    found = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return sorted(found, key=lambda members: (-len(members), labels[members[0]]))


def is_wrong(
    labels: Int64[np.ndarray, " m"], identity: Int64[np.ndarray, " m"]
) -> Bool[np.ndarray, " m"]:
    """Which observations are, by the truth, of another object than most of their cluster.

    Clutter (identity -1) is wrong wherever it is with anything else.
    """
    wrong = np.zeros(len(labels), dtype=bool)
    for members in groups(labels):
        values, count = np.unique(identity[members], return_counts=True)
        count = np.where(values < 0, 0, count)
        if len(members) > 1:
            main = values[count.argmax()]
            wrong[members] = (identity[members] != main) | (main < 0)
    return wrong


def wrong_by_truth(
    observations: Observations, labels: Int64[np.ndarray, " m"]
) -> Bool[np.ndarray, " m"]:
    """:func:`is_wrong`, or nothing wrong where the truth is not known."""
    identity = observations.features.get("identity")
    if identity is None or not bool((identity >= 0).any()):
        return np.zeros(len(labels), dtype=bool)
    return is_wrong(labels, identity.cpu().numpy())


def _oklab_to_srgb(lightness: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    long = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3
    middle = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    short = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    cones = np.stack([long, middle, short], axis=-1)
    matrix = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip(cones @ matrix.T, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
