"""Picture of the crops of each cluster, the clusters one after another, the largest first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

from mixer_torch.extras import require
from mixer_torch.observations import Images, Observations
from mixer_torch.plots.style import (
    FADED,
    INK,
    WRONG,
    blank_figure,
    colors,
    groups,
    new_figure,
    wrong_by_truth,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 100
LABEL, TAIL = 126, 48
"""Pixels left of a cluster's crops, for its number and size; right of them, for how many are not
shown."""
GAP, FRAME, HEAD = 6, 3, 40
"""Pixels between crops, of the frame around a crop, and above all lines, for the caption."""


@dataclass
class Strip:
    """One cluster in the picture: a label and framed crops in a line.

    Args:
        title: Number of the cluster.
        note: Its size.
        color: Of the title, (3,) in 0..1.
        note_color: Of the note.
        shown: Observations in it, in order.
        hidden: How many more there are.
        width: Pixels.
    """

    title: str
    note: str
    color: Any
    note_color: Any
    shown: np.ndarray
    hidden: int
    width: int
    left: int = 0
    line: int = 0


def clusters_figure(
    observations: Observations,
    labels: Tensor,
    lines: int = 24,
    width: int = 1800,
    largest: int = 64,
) -> Figure:
    """The crops of each cluster in the order of time, and those that are alone at the end.

    A crop is framed in the colour of its cluster, or in red if it is by the truth of another
    object than most of its cluster. Where a cluster has more crops than there is room for in a
    line, those shown are spread evenly over it.

    Args:
        observations: With images.
        labels: (m,) the cluster of each.
        lines: Lines of crops at most; what does not fit is counted in the heading.
        width: Of the picture, pixels.
        largest: Height of a crop, pixels; less where not all clusters fit so.
    """
    if observations.images is None:
        raise ValueError("observations: expected images to take crops from, got none")
    if not len(labels):
        return blank_figure("no observations")
    numbers = labels.cpu().numpy()
    wrong = wrong_by_truth(observations, numbers)
    for height in (largest, round(0.7 * largest)):
        sizes = _tile_widths(observations.images, height)
        strips = _strips(observations, numbers, wrong, sizes, width)
        shown = _lay_out(strips, width, lines)
        if len(shown) == len(strips):
            break
    crops = _crops(observations.images, np.concatenate([s.shown for s in shown]), height)
    step = height + 2 * FRAME + 2 * GAP
    canvas = np.full((HEAD + step * (shown[-1].line + 1), width, 3), 255, dtype=np.uint8)
    texts: list[tuple] = [(2 * GAP, HEAD / 2, _caption(strips, shown, wrong), INK, 10.5)]
    for strip in shown:
        top = HEAD + strip.line * step
        left = strip.left + LABEL
        for i in strip.shown:
            own = FADED if strip.color is FADED else colors(numbers[i : i + 1])[0]
            left = _paste(canvas, top, left, crops[i], WRONG if wrong[i] else own)
        middle = top + FRAME + height / 2
        texts.append((strip.left + 2 * GAP, middle - 12, strip.title, strip.color, 13.0))
        texts.append((strip.left + 2 * GAP, middle + 14, strip.note, strip.note_color, 8.5))
        if strip.hidden:
            texts.append((left + 2, middle, f"+{strip.hidden}", INK, 11.0))
    return _figure(canvas, texts)


def _strips(
    observations: Observations,
    numbers: np.ndarray,
    wrong: np.ndarray,
    sizes: np.ndarray,
    width: int,
) -> list[Strip]:
    clusters = groups(numbers)
    several = [members for members in clusters if len(members) > 1]
    single = np.array([members[0] for members in clusters if len(members) == 1], dtype=np.int64)
    strips = []
    for group in [*several, *([single] if len(single) else [])]:
        alone = group is single
        shown = _that_fit(_in_time(observations, group), sizes, width - LABEL - TAIL)
        errors = int(wrong[group].sum())
        color = FADED if alone else tuple(0.92 * colors(numbers[group[:1]])[0])
        strips.append(
            Strip(
                title="● alone" if alone else f"● {numbers[group[0]]}",
                note=f"{len(group)} seen" + (f", {errors} wrong" if errors else ""),
                color=color,
                note_color=WRONG if errors else INK,
                shown=shown,
                hidden=len(group) - len(shown),
                width=LABEL + int(sizes[shown].sum()) + (TAIL if len(shown) < len(group) else 0),
            )
        )
    return strips


def _lay_out(strips: list[Strip], width: int, lines: int) -> list[Strip]:
    """Place strips from left to right in lines, in their order; returns those that fit."""
    left = line = 0
    for place, strip in enumerate(strips):
        if left and left + strip.width > width:
            left, line = 0, line + 1
        if line >= lines:
            return strips[:place]
        strip.left, strip.line = left, line
        left += strip.width + 3 * GAP
    return strips


def _in_time(observations: Observations, members: np.ndarray) -> np.ndarray:
    for key in ("time", "frame"):
        if key in observations.features:
            value = observations[key].cpu().numpy()[members]
            return members[np.argsort(value, kind="stable")]
    return members


def _tile_widths(images: Images, height: int) -> np.ndarray:
    """(m,) pixels across that each crop takes in a line, from its box where there are boxes."""
    rows, columns = images.frame(int(np.argmin(images.frame_index))).shape[:2]
    if images.box is None:
        ratio = np.full(len(images), columns / rows)
    else:
        corners = np.nan_to_num(images.box).reshape(-1, 2, 2)
        low, high = np.floor(corners[:, 0]), np.ceil(corners[:, 1])
        size = np.clip(high, 0, (columns, rows)) - np.clip(low, 0, (columns, rows))
        ratio = np.maximum(size[:, 0], 1) / np.maximum(size[:, 1], 1)
    return np.ceil(np.clip(ratio, 0.2, 2) * height) + 2 * FRAME + GAP


def _that_fit(members: np.ndarray, sizes: np.ndarray, room: int) -> np.ndarray:
    """As many of the members as fit in a line, spread evenly, with both ends."""
    count = len(members)
    for most in range(min(count, max(int(room // sizes[members].min()), 1)), 0, -1):
        chosen = members[np.linspace(0, count - 1, most).round().astype(np.int64)]
        if sizes[chosen].sum() <= room or most == 1:
            return chosen
    return members[:1]


def _crops(images: Images, chosen: np.ndarray, height: int) -> dict[int, np.ndarray]:
    """Crops by observation, as large as their tiles; each frame is decoded once."""
    cv2 = require("cv2", extra="vision")
    crops = {}
    for k, crop in images.select(chosen).crops():
        scale = min(height / crop.shape[0], 2 * height / crop.shape[1])
        size = [max(round(side * scale), 1) for side in (crop.shape[1], crop.shape[0])]
        method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        crops[int(chosen[k])] = cv2.resize(np.ascontiguousarray(crop), size, interpolation=method)
    return crops


def _paste(canvas: np.ndarray, top: int, left: int, crop: np.ndarray, color: Any) -> int:
    """Put a framed crop on the canvas; returns where the next one goes."""
    tile = np.empty((crop.shape[0] + 2 * FRAME, crop.shape[1] + 2 * FRAME, 3), dtype=np.uint8)
    tile[:] = np.round(np.asarray(color) * 255)
    tile[FRAME:-FRAME, FRAME:-FRAME] = crop
    room = canvas[top : top + tile.shape[0], left : left + tile.shape[1]]
    room[:] = tile[: room.shape[0], : room.shape[1]]
    return left + tile.shape[1] + GAP


def _caption(strips: list[Strip], shown: list[Strip], wrong: np.ndarray) -> str:
    parts = ["Clusters, the largest first, each in the order of time."]
    if wrong.any():
        parts.append("Framed in red: by the truth another object than most of the cluster.")
    if len(shown) < len(strips):
        left = sum(len(strip.shown) + strip.hidden for strip in strips[len(shown) :])
        parts.append(f"Not shown: {left} observations in smaller clusters.")
    return "  ".join(parts)


def _figure(canvas: np.ndarray, texts: list[tuple]) -> Figure:
    height, width = canvas.shape[:2]
    figure = new_figure(width / DPI, height / DPI, DPI)
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set_axis_off()
    axis.imshow(canvas, interpolation="nearest", aspect="auto", extent=(0, width, height, 0))
    for x, y, text, color, size in texts:
        axis.text(x, y, text, color=color, fontsize=size, va="center")
    return figure
