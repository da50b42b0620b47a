"""Frames with boxes coloured and numbered by cluster: some of them as a picture, all as a video."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

from mixer_torch.io.frames import NumberedFrames
from mixer_torch.observations import Images, Observations
from mixer_torch.plots.style import (
    FADED,
    INK,
    WRONG,
    blank_figure,
    colors,
    new_figure,
    wrong_by_truth,
)
from mixer_torch.plots.video import Drawing, write_drawn
from mixer_torch.scoring import Progress

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMN_INCHES = 4.6
DPI = 110


def frames_figure(
    observations: Observations, labels: Tensor, most: int = 8, columns: int = 4
) -> Figure:
    """The fullest frame of each stretch of time, with coloured boxes.

    Observations that are alone in their cluster have a thin grey box; those that are by the truth
    of another object than most of their cluster have a dashed red one.

    Args:
        observations: With images and boxes.
        labels: (m,) the cluster of each.
        most: Frames shown at most.
        columns: Frames side by side.
    """
    images = _images(observations)
    if not len(labels):
        return blank_figure("no observations")
    numbers = labels.cpu().numpy()
    wrong = wrong_by_truth(observations, numbers)
    single = np.bincount(numbers)[numbers] == 1
    seen, count = np.unique(images.frame_index, return_counts=True)
    stretches = np.array_split(np.arange(len(seen)), min(most, len(seen)))
    chosen = [seen[stretch[count[stretch].argmax()]] for stretch in stretches]
    groups = [np.flatnonzero(images.frame_index == index) for index in chosen]
    shape = images.frame(int(groups[0][0])).shape
    figure, axes = _grid(len(groups), min(columns, len(groups)), shape[0] / shape[1])
    figure.suptitle(_caption(wrong), x=0.006, y=0.995, ha="left", va="top", color=INK)
    for axis, group in zip(axes, groups, strict=True):
        _draw_frame(axis, images, group, numbers, single, wrong)
        axis.set_title(_name(observations, int(group[0])), loc="left", fontsize=9, color=INK, pad=3)
    return figure


def _grid(count: int, columns: int, aspect: float) -> tuple[Figure, list[Axes]]:
    """Axes in rows, of one aspect (height / width), with room for titles."""
    gap, title, head = 0.1, 0.26, 0.32
    cell = (COLUMN_INCHES + gap, COLUMN_INCHES * aspect + title)
    width = columns * cell[0] + gap
    height = -(-count // columns) * cell[1] + head + gap
    figure = new_figure(width, height, DPI)
    axes = []
    for k in range(count):
        row, column = divmod(k, columns)
        left, bottom = gap + column * cell[0], height - head - (row + 1) * cell[1]
        rectangle = (
            left / width,
            bottom / height,
            COLUMN_INCHES / width,
            COLUMN_INCHES * aspect / height,
        )
        axes.append(figure.add_axes(rectangle))
        axes[-1].set_axis_off()
    return figure, axes


def _draw_frame(
    axis: Axes,
    images: Images,
    group: np.ndarray,
    numbers: np.ndarray,
    single: np.ndarray,
    wrong: np.ndarray,
) -> None:
    from matplotlib.patches import Rectangle
    from matplotlib.patheffects import Normal, Stroke

    frame = images.frame(int(group[0]))
    axis.imshow(frame, interpolation="antialiased")
    for i in group:
        x1, y1, x2, y2 = images.box[i]  # type: ignore[index]
        color = FADED if single[i] else tuple(colors(numbers[i : i + 1])[0])
        edge, style = (WRONG, (0, (3, 2))) if wrong[i] else (color, "-")
        line = 0.9 if single[i] else 1.8
        halo = [Stroke(linewidth=line + 1.4, foreground="white", alpha=0.6), Normal()]
        axis.add_patch(
            Rectangle(
                (x1, y1),
                x2 - x1,
                y2 - y1,
                fill=False,
                edgecolor=edge,
                linestyle=style,
                linewidth=line,
                path_effects=halo,
            )
        )
        if not single[i]:
            chip = {"facecolor": color, "edgecolor": "none", "boxstyle": "square,pad=0.15"}
            axis.text(
                max(x1, 0),
                max(y1, 0),
                str(numbers[i]),
                color="white",
                fontsize=7,
                fontweight="bold",
                va="bottom",
                bbox=chip,
                clip_on=True,
            )
    axis.set_xlim(0, frame.shape[1])
    axis.set_ylim(frame.shape[0], 0)


def write_video(
    path: str | Path,
    observations: Observations,
    labels: Tensor,
    progress: Progress | None = None,
) -> None:
    """Write an mp4 of the frames, with boxes as in the picture and trails of the last second.

    Frames in which nothing was seen, between others, are in the video, too. Boxes are drawn as by
    :func:`~mixer_torch.plots.video.write_track_video`.

    Args:
        path: File to write.
        observations: With images and boxes; ``time`` gives the frames per second, 10 without it.
        labels: (m,) the cluster of each.
        progress: Told what is done while it goes on.

    Raises:
        OSError: The video cannot be written.
        ValueError: There are no observations, no images or no boxes.
    """
    images = _images(observations)
    if not len(labels):
        raise ValueError("observations: expected at least one for a video, got none")
    box: Any = images.box
    shown = _shown(images)
    camera = observations.camera
    rows = np.flatnonzero(np.isfinite(box).all(1))
    rows = rows[np.argsort(images.frame_index[rows], kind="stable")]
    drawing = Drawing(
        images.frame_index[rows],
        camera.cpu().numpy()[rows],
        labels.cpu().numpy()[rows],
        box[rows],
        np.zeros(len(rows), dtype=bool),
    )
    frames = NumberedFrames(shown, shown, images.frames)
    captions = _captions(observations, images, shown)
    write_drawn(path, drawing, frames, captions, _frame_rate(observations, images), progress)


def _shown(images: Images) -> np.ndarray:
    """From the first frame with an observation to the last, in the steps that they are apart.

    So every 20th frame, where every 20th was observed, but also those in which nothing was seen.
    """
    seen = np.unique(images.frame_index)
    return np.arange(seen[0], seen[-1] + 1, max(int(np.gcd.reduce(np.diff(seen))), 1))


def _captions(observations: Observations, images: Images, shown: np.ndarray) -> list[str]:
    """The names of the frames shown; empty for those without observations, which have no name."""
    seen, first = np.unique(images.frame_index, return_index=True)
    names = {k: _name(observations, int(i)) for k, i in zip(seen, first, strict=True)}
    return [names.get(k, "") for k in shown]


def _frame_rate(observations: Observations, images: Images) -> float:
    """By how much the index of a frame grows in a second; 10 where there is no time."""
    if "time" not in observations.features:
        return 10.0
    index, first = np.unique(images.frame_index, return_index=True)
    seconds = np.diff(observations["time"].cpu().numpy()[first])
    passes = seconds > 0
    return float(np.median(np.diff(index)[passes] / seconds[passes])) if passes.any() else 10.0


def _images(observations: Observations) -> Images:
    if observations.images is None or observations.images.box is None:
        raise ValueError("observations: expected images with boxes, got none")
    return observations.images


def _name(observations: Observations, i: int) -> str:
    camera, frame = (observations.features.get(key) for key in ("camera", "frame"))
    parts = [] if frame is None else [f"frame {int(frame[i])}"]
    if camera is not None and bool((camera != camera[i]).any()):
        parts.insert(0, f"camera {int(camera[i])}")
    return ", ".join(parts) or f"view {int(observations.view[i])}"


def _caption(wrong: np.ndarray) -> str:
    text = "Boxes are coloured and numbered by cluster; thin grey: alone in its cluster"
    return text + (
        "; dashed red: by the truth another object than most of its cluster" if wrong.any() else ""
    )
