"""Picture of the scores ordered by cluster, with what was found and what is true beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from mixer_torch.affinity import Affinity
from mixer_torch.association import Association
from mixer_torch.fusion import Fusion
from mixer_torch.plots.style import (
    FADED,
    INK,
    MISSED,
    WRONG,
    blank_figure,
    by_size,
    colors,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 130
LARGEST_MAP = 900
"""Cells a side of a heat map; more observations than that are averaged in blocks. A panel
has 624 pixels a side (4.8 inches at DPI), so a finer map would look the same."""


def affinity_figure(
    affinity: Affinity,
    association: Association,
    identity: Tensor | None = None,
    fusion: Fusion | None = None,
) -> Figure:
    """The fused scores, the clusters found, and the truth, all in the order of the clusters.

    Args:
        affinity: How alike.
        association: Who is who; in the order of connected components if it has no labels.
        identity: (m,) the truth; no third panel where it is None.
        fusion: How the modalities add up; the paper's if None.
    """
    m = len(affinity)
    if not m:
        return blank_figure("no observations")
    labels = _labels_or_components(association, m)
    order = np.argsort(np.argsort(by_size(labels))[labels], kind="stable")
    panels = 2 if identity is None else 3
    figure, axes = _square_panels(panels)
    place = np.empty(m, dtype=np.int64)
    place[order] = np.arange(m)
    evidence = -affinity.cost(fusion).detach().double().cpu().numpy()
    _draw_evidence(axes[0], place[affinity.pairs.cpu().numpy()], evidence, m)
    found = _together(labels[order])
    _draw_found(axes[1], labels[order], found)
    if identity is not None:
        _draw_truth(axes[2], labels[order], identity.cpu().numpy()[order], found)
    for axis in axes:
        _cluster_ticks(axis, labels[order])
    axes[0].set_ylabel("observations, by cluster, the largest first", color=INK)
    return figure


def _square_panels(count: int) -> tuple[Figure, list[Axes]]:
    """Squares side by side, with room for titles above and keys below."""
    left, side, gap, bottom, top = 0.6, 4.8, 0.5, 0.85, 0.5
    width, height = left + count * (side + gap) - gap + 0.15, bottom + side + top
    figure = new_figure(width, height, DPI)
    axes = [
        figure.add_axes(
            (
                (left + k * (side + gap)) / width,
                bottom / height,
                side / width,
                side / height,
            )
        )
        for k in range(count)
    ]
    return figure, axes


def _draw_evidence(axis: Axes, place: np.ndarray, evidence: np.ndarray, m: int) -> None:
    cells = min(m, LARGEST_MAP)
    rows, columns = place * cells // m
    image = np.zeros((cells, cells))
    np.add.at(image, (rows, columns), evidence)
    np.add.at(image, (columns, rows), evidence)
    image /= np.outer(*[np.bincount(np.arange(m) * cells // m, minlength=cells)] * 2)
    strongest = max(float(np.abs(image).max()), 1e-9)
    drawn = axis.imshow(
        image,
        cmap="PRGn",
        vmin=-strongest,
        vmax=strongest,
        extent=(0, m, m, 0),
        interpolation="nearest",
    )
    axis.set_title("What the scores say", loc="left", fontweight="bold", color=INK)
    inset = axis.inset_axes((0.08, -0.065, 0.84, 0.03))
    bar = axis.figure.colorbar(drawn, cax=inset, orientation="horizontal")
    bar.set_label("different  ←  minus the fused cost; 0 has nothing to say  →  same", color=INK)
    bar.outline.set_visible(False)


def _draw_found(axis: Axes, labels: np.ndarray, found: np.ndarray) -> None:
    m, cells = len(labels), len(found)
    middle = labels[(np.arange(cells) * m + m // 2) // cells]
    strength = found[..., None]
    image = 1 - strength * (1 - colors(middle)[:, None, :])
    axis.imshow(image, extent=(0, m, m, 0), interpolation="nearest")
    size = np.unique(labels, return_counts=True)[1]
    axis.set_title("What was found", loc="left", fontweight="bold", color=INK)
    singles = int((size == 1).sum())
    axis.set_xlabel(f"{len(size)} clusters, {singles} of them of one observation", color=INK)


def _draw_truth(axis: Axes, labels: np.ndarray, identity: np.ndarray, found: np.ndarray) -> None:
    from matplotlib.patches import Patch

    m = len(labels)
    known = identity >= 0
    unique = np.where(known, identity, identity.max(initial=0) + 1 + np.arange(m))
    true = _together(np.unique(unique, return_inverse=True)[1])
    both = _together(np.unique(np.stack([labels, unique]), axis=1, return_inverse=True)[1].ravel())
    image = np.ones((*both.shape, 3))
    for part, color in ((both, INK), (found - both, WRONG), (true - both, MISSED)):
        image -= part[..., None] * (1 - np.asarray(color))
    axis.imshow(np.clip(image, 0, 1), extent=(0, m, m, 0), interpolation="nearest")
    axis.set_title("What is true, in the same order", loc="left", fontweight="bold", color=INK)
    names = (("found and true", INK), ("found, not true", WRONG), ("true, not found", MISSED))
    axis.legend(
        handles=[Patch(color=color, label=name) for name, color in names],
        loc="upper center",
        bbox_to_anchor=(0.5, -0.03),
        ncols=3,
        frameon=False,
        handlelength=1,
        columnspacing=1.2,
    )


def _together(labels: np.ndarray) -> np.ndarray:
    """Share of each block of pairs that has one label, in at most LARGEST_MAP blocks a side."""
    m = len(labels)
    cells = min(m, LARGEST_MAP)
    block = np.arange(m) * cells // m
    kinds = np.unique(labels, return_inverse=True)[1].ravel()
    count = coo_array((np.ones(m), (block, kinds)), shape=(cells, kinds.max() + 1)).tocsr()
    size = np.bincount(block, minlength=cells)
    return (count @ count.T).toarray() / np.outer(size, size)


def _cluster_ticks(axis: Axes, labels: np.ndarray) -> None:
    """The number of each cluster that is wide enough to carry it, at its middle, in its colour."""
    m = len(labels)
    starts = np.flatnonzero(np.diff(labels, prepend=-1))
    sizes = np.diff(np.append(starts, m))
    wide = sizes >= max(0.028 * m, 1)
    middles, names = (starts + sizes / 2)[wide], labels[starts[wide]]
    axis.set_xticks([])
    axis.set_yticks(middles, [str(name) for name in names], fontsize=7)
    for text, color in zip(axis.get_yticklabels(), colors(names), strict=True):
        text.set_color(color * 0.8)
        text.set_fontweight("bold")
    axis.tick_params(length=0, pad=2)
    for spine in axis.spines.values():
        spine.set_color(FADED)
        spine.set_linewidth(0.6)


def _labels_or_components(association: Association, m: int) -> np.ndarray:
    if association.labels is not None:
        return association.labels.cpu().numpy()
    a, b = association.links.cpu().numpy()
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(m, m))
    return connected_components(graph, directed=False)[1].astype(np.int64)
