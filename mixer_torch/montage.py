"""Picture of the crops of each cluster, one cluster a row."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

from mixer_torch.colors import INK, WRONG, by_size, colors, wrong_by_truth
from mixer_torch.observations import Observations
from mixer_torch.plots import blank_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARGIN = 130
"""Pixels left of the crops, for the number of the cluster."""
TAIL = 70
"""Pixels right of them, for how many are not shown."""
GAP = 8
FRAME = 3
HEAD = 44
DPI = 100


def clusters_figure(
    observations: Observations, labels: Tensor, rows: int = 24, width: int = 1800, height: int = 84
) -> Figure:
    """The crops of each cluster in the order of time, the largest cluster first.

    A crop is framed in the colour of its cluster, or in red if it is by the truth of another
    object than most of its row. Where a row has more crops than there is room for, those shown are
    spread evenly over it.

    Args:
        observations: With images.
        labels: (m,) the cluster of each.
        rows: Clusters shown at most.
        width: Of the picture, pixels.
        height: Of a crop, pixels.
    """
    if not len(labels):
        return blank_figure("no observations")
    numbers = labels.cpu().numpy()
    wrong = wrong_by_truth(observations, numbers)
    ranked = by_size(numbers)
    members = [_in_time(observations, np.flatnonzero(numbers == label)) for label in ranked[:rows]]
    room = width - MARGIN - TAIL
    chosen = [_that_fit(observations, group, height, room) for group in members]
    crops = _crops(observations, np.concatenate(chosen), height)
    step = height + 2 * FRAME + GAP
    canvas = np.full((HEAD + step * len(chosen), width, 3), 255, dtype=np.uint8)
    texts = [(GAP, HEAD / 2, _caption(ranked, numbers, rows, wrong), INK, 10.0)]
    for row, (label, group, some) in enumerate(zip(ranked, members, chosen, strict=False)):
        color = colors(np.array([label]))[0]
        top = HEAD + row * step
        right = _paste_row(canvas, top, [(crops[i], WRONG if wrong[i] else color) for i in some])
        middle = top + FRAME + height / 2
        errors = int(wrong[group].sum())
        seen = f"{len(group)} seen" + (f", {errors} wrong" if errors else "")
        texts.append((GAP, middle - 12, f"● {label}", tuple(color * 0.9), 13.0))
        texts.append((GAP, middle + 14, seen, WRONG if errors else INK, 8.5))
        if len(some) < len(group):
            texts.append((right + GAP, middle, f"+{len(group) - len(some)}", INK, 11.0))
    return _figure(canvas, texts)


def _in_time(observations: Observations, members: np.ndarray) -> np.ndarray:
    for key in ("time", "frame"):
        if key in observations.features:
            value = observations[key].cpu().numpy()[members]
            return members[np.argsort(value, kind="stable")]
    return members


def _that_fit(
    observations: Observations, members: np.ndarray, height: int, room: int
) -> np.ndarray:
    """As many of the members as fit in a row, spread evenly, with both ends."""
    box = None if observations.images is None else observations.images.box
    ratio = np.ones(len(members))
    if box is not None:
        size = np.maximum(np.nan_to_num(box[members, 2:] - box[members, :2]), 1)
        ratio = np.minimum(size[:, 0] / size[:, 1], 2)
    elif observations.images is not None:
        shape = observations.images.frame(int(members[0])).shape
        ratio *= min(shape[1] / shape[0], 2)
    taken = ratio * height + 2 * FRAME + GAP
    most = max(int(room // taken.mean()), 1)
    while most > 1 and taken[_spread(len(members), most)].sum() > room:
        most -= 1
    return members[_spread(len(members), most)]


def _spread(count: int, most: int) -> np.ndarray:
    if count <= most:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, most).round().astype(np.int64))


def _crops(observations: Observations, chosen: np.ndarray, height: int) -> dict[int, np.ndarray]:
    """Crops by observation, of one height unless very wide; each frame is decoded once."""
    import cv2

    if observations.images is None:
        raise ValueError("observations: expected images to take crops from, got none")
    crops = {}
    for k, crop in observations.images.select(chosen).crops():
        scale = min(height / crop.shape[0], 2 * height / crop.shape[1])
        size = [max(round(side * scale), 1) for side in (crop.shape[1], crop.shape[0])]
        method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        crops[int(chosen[k])] = cv2.resize(np.ascontiguousarray(crop), size, interpolation=method)
    return crops


def _paste_row(
    canvas: np.ndarray, top: int, tiles: list[tuple[np.ndarray, tuple[float, ...] | np.ndarray]]
) -> int:
    """Put framed crops side by side; returns where the row ends."""
    left = MARGIN
    for crop, color in tiles:
        height, width = crop.shape[0] + 2 * FRAME, crop.shape[1] + 2 * FRAME
        tile = np.empty((height, width, 3), dtype=np.uint8)
        tile[:] = np.round(np.asarray(color) * 255)
        tile[FRAME:-FRAME, FRAME:-FRAME] = crop
        width = min(width, canvas.shape[1] - left)
        canvas[top : top + height, left : left + width] = tile[:, :width]
        left += width + GAP
    return left - GAP


def _caption(ranked: np.ndarray, numbers: np.ndarray, rows: int, wrong: np.ndarray) -> str:
    parts = ["One cluster a row, the largest first, in the order of time."]
    if wrong.any():
        parts.append("Framed in red: by the truth another object than most of the row.")
    if len(ranked) > rows:
        seen = int(np.isin(numbers, ranked[rows:]).sum())
        parts.append(f"Not shown: {len(ranked) - rows} smaller clusters, {seen} observations.")
    return "  ".join(parts)


def _figure(canvas: np.ndarray, texts: list[tuple]) -> Figure:
    from matplotlib.figure import Figure

    height, width = canvas.shape[:2]
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set_axis_off()
    axis.imshow(canvas, interpolation="nearest", aspect="auto", extent=(0, width, height, 0))
    for x, y, text, color, size in texts:
        axis.text(x, y, text, color=color, fontsize=size, va="center")
    return figure
