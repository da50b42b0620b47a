"""Frames with boxes coloured and numbered by cluster: some of them as a picture, all as a video."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from mixer_torch.observations import Images, Observations
from mixer_torch.plots.style import FADED, INK, WRONG, blank_figure, colors, wrong_by_truth
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
    from matplotlib.figure import Figure

    gap, title, head = 0.1, 0.26, 0.32
    cell = (COLUMN_INCHES + gap, COLUMN_INCHES * aspect + title)
    width = columns * cell[0] + gap
    height = -(-count // columns) * cell[1] + head + gap
    figure = Figure(figsize=(width, height), dpi=DPI)
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
    """Write an mp4 of all frames in which something was seen, with boxes as in the picture.

    Args:
        path: File to write.
        observations: With images and boxes; ``time`` gives the frames per second, 10 without it.
        labels: (m,) the cluster of each.
        progress: Told what is done while it goes on.

    Raises:
        OSError: The video cannot be written.
        ValueError: There are no observations, no images or no boxes.
    """
    import cv2

    images = _images(observations)
    if not len(labels):
        raise ValueError("observations: expected at least one for a video, got none")
    numbers = labels.cpu().numpy()
    single = np.bincount(numbers)[numbers] == 1
    seen = np.unique(images.frame_index)
    height, width = images.frame(int(np.argmin(images.frame_index))).shape[:2]
    rate = _frames_per_second(observations, images)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
    if not writer.isOpened():
        raise OSError(f"{path}: OpenCV cannot write this video here")
    try:
        for done, index in enumerate(seen):
            group = np.flatnonzero(images.frame_index == index)
            frame = cv2.cvtColor(images.frame(int(group[0])), cv2.COLOR_RGB2BGR)
            frame = (
                frame if frame.shape[:2] == (height, width) else cv2.resize(frame, (width, height))
            )
            for i in group:
                _draw_box(frame, images.box[i], int(numbers[i]), bool(single[i]))  # type: ignore[index]
            writer.write(frame)
            if progress is not None:
                progress("video: frames", done + 1, len(seen))
    finally:
        writer.release()


def _draw_box(frame: np.ndarray, box: np.ndarray, number: int, single: bool) -> None:
    import cv2

    color = np.asarray(FADED) if single else colors(np.array([number]))[0]
    bgr = [round(float(value) * 255) for value in color[::-1]]
    x1, y1, x2, y2 = (round(float(value)) for value in np.nan_to_num(box))
    cv2.rectangle(frame, (x1, y1), (x2, y2), bgr, 1 if single else 2, cv2.LINE_AA)
    if not single:
        font, text = cv2.FONT_HERSHEY_SIMPLEX, str(number)
        (width, height), base = cv2.getTextSize(text, font, 0.45, 1)
        left, bottom = max(x1, 0), max(y1, height + base)
        corner = (left + width + 4, bottom - height - base)
        cv2.rectangle(frame, (left, bottom), corner, bgr, cv2.FILLED)
        cv2.putText(
            frame,
            text,
            (left + 2, bottom - base // 2 - 1),
            font,
            0.45,
            (255, 255, 255),
            1,
            cv2.LINE_AA,
        )


def _frames_per_second(observations: Observations, images: Images) -> float:
    """From the median time between frames, within what people can follow."""
    if "time" not in observations.features:
        return 10.0
    first = np.unique(images.frame_index, return_index=True)[1]
    step = torch.diff(observations["time"].cpu()[torch.from_numpy(first)])
    step = step[step > 0]
    return float(np.clip(1 / float(step.median()), 2, 30)) if len(step) else 10.0


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
