"""Plots of calibration: reliability diagrams, and histograms of scores by kind of pair."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from mixer_torch.metrics.calibration import expected_calibration_error, reliability
from mixer_torch.plots.style import INK, MISSED, WRONG, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["histograms_figure", "reliability_figure", "save"]

Ratios = Mapping[str, Mapping[str, tuple[Tensor, Tensor]]]
"""By what is compared and by modality: log likelihood ratios and whether pairs are the same."""
SAME, DIFFERENT = (0.13, 0.45, 0.70), (0.93, 0.55, 0.15)


def reliability_figure(ratios: Ratios) -> Figure:
    """Reliability diagrams: share of same pairs, at prior 0.5, against the score.

    A calibrated score is on the diagonal. One row for each way of scoring, one column for each
    modality; the area of a dot is the share of the pairs with such scores.
    """
    figure, panels = _grid(ratios, "score", "share of same pairs, at prior 0.5")
    for axes, title, ratio, same in panels:
        table = reliability(ratio, same)
        axes.plot([0, 1], [0, 1], color=INK, linewidth=0.8, linestyle=":")
        axes.plot(table["score"], table["share"], color=WRONG, linewidth=1)
        axes.scatter(table["score"], table["share"], 150 * table["weight"] + 4, color=[WRONG])
        error = expected_calibration_error(ratio, same)
        axes.set_title(f"{title}: ECE {error:.3f}", fontsize=8, color=INK)
        axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    return figure


def histograms_figure(ratios: Ratios) -> Figure:
    """Histograms of the scores of same and of different pairs, each normalised by itself."""
    figure, panels = _grid(ratios, "score", "share of the kind")
    edges = np.linspace(0, 1, 31).tolist()
    for axes, title, ratio, same in panels:
        score = torch.sigmoid(ratio).numpy()
        for kept, color, label in ((same, SAME, "same"), (~same, DIFFERENT, "different")):
            chosen = score[kept.numpy()]
            weights = np.full(len(chosen), 1 / max(len(chosen), 1))
            axes.hist(chosen, edges, weights=weights, color=color, alpha=0.6, label=label)
        axes.axvline(0.5, color=MISSED, linewidth=0.8)
        axes.set_title(title, fontsize=8, color=INK)
        axes.set(xlim=(0, 1), ylim=(0, 1))
    panels[0][0].legend(fontsize=7, frameon=False)
    return figure


def _grid(
    ratios: Ratios, below: str, beside: str
) -> tuple[Figure, list[tuple[Axes, str, Tensor, Tensor]]]:
    from matplotlib.figure import Figure

    columns = max(len(row) for row in ratios.values())
    size = (2.4 * columns + 0.6, 2.5 * len(ratios) + 0.4)
    figure = Figure(figsize=size, dpi=120, layout="constrained")
    grid = figure.subplots(len(ratios), columns, squeeze=False)
    panels = []
    for line, (name, row) in zip(grid, ratios.items(), strict=True):
        for axes in line[len(row) :]:
            axes.set_axis_off()
        for axes, (modality, (ratio, same)) in zip(line, row.items(), strict=False):
            panels.append((axes, f"{modality}, {name}", ratio, same))
            axes.tick_params(labelsize=6)
    figure.supxlabel(below, fontsize=8, color=INK)
    figure.supylabel(beside, fontsize=8, color=INK)
    return figure, panels
