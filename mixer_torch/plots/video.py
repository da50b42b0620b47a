"""A video of tracks: boxes and identities in every frame, and where each was in the last second."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from mixer_torch.extras import require
from mixer_torch.io.frames import NumberedFrames
from mixer_torch.plots.style import FADED, colors
from mixer_torch.scoring import Progress
from mixer_torch.tracks import Tracks

TRAIL_SECONDS = 1.0
FRAMES_PER_SECOND = (2.0, 60.0)
"""Slowest and fastest of a video: what a viewer can follow and common players can play."""
DARK, LIGHT = (24, 20, 18), (255, 255, 255)
SHADE = 0.3
"""Brightness of the line around a box, which sets it apart from a background of its colour."""
LUMA = (0.114, 0.587, 0.299)
"""Weights of blue, green and red in brightness (ITU-R BT.601)."""


def write_track_video(
    path: str | Path,
    tracks: Tracks,
    frames: NumberedFrames,
    frame_rate: float,
    progress: Progress | None = None,
) -> None:
    """Write an mp4 of frames with the boxes of tracks, each identity in a colour of its own.

    A trail shows where the foot of a box was in the last second. Boxes that were interpolated
    (of no observation, while others are of one) are dashed; an identity that has one box
    in all is thin, grey, and not numbered. Frames without boxes are in the video, too.

    Args:
        path: File to write; its name ends in mp4.
        tracks: Of one camera.
        frames: The frames to show, numbered as those of the tracks are.
        frame_rate: By how much the number of a frame grows in a second.
        progress: Told what is done while it goes on.

    Raises:
        OSError: The video cannot be written.
        ValueError: There is no frame, or tracks are of several cameras.
    """
    if not len(frames):
        raise ValueError("frames: expected one or more, got none")
    if len(cameras := np.unique(tracks.camera)) > 1:
        raise ValueError(f"tracks: expected one camera, got {cameras.tolist()}; select one of them")
    captions = [f"frame {number}" for number in frames.number]
    write_drawn(path, Drawing.of_tracks(tracks), frames, captions, frame_rate, progress)


def write_drawn(
    path: str | Path,
    drawing: Drawing,
    frames: NumberedFrames,
    captions: Sequence[str],
    frame_rate: float,
    progress: Progress | None = None,
) -> None:
    """Write an mp4 of one frame or more, with boxes drawn on them and a caption each.

    Raises:
        OSError: The video cannot be written.
    """
    cv2 = require("cv2", extra="vision")
    height, width = frames.frames[int(frames.place[0])].shape[:2]
    rate = float(np.clip(frame_rate / _step(frames), *FRAMES_PER_SECOND))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
    if not writer.isOpened():
        raise OSError(f"{path}: OpenCV cannot write this video here")
    try:
        drawn = drawn_frames(drawing, frames, captions, frame_rate)
        for done, frame in enumerate(drawn, 1):
            same = frame.shape[:2] == (height, width)
            writer.write(frame if same else cv2.resize(frame, (width, height)))
            if progress is not None:
                progress("video: frames", done, len(frames))
    finally:
        writer.release()


def drawn_frames(
    drawing: Drawing, frames: NumberedFrames, captions: Sequence[str], frame_rate: float
) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """The frames with what is drawn on them, BGR, one after the other."""
    cv2 = require("cv2", extra="vision")
    memory = max(TRAIL_SECONDS * frame_rate, 2 * _step(frames))
    for number, place, caption in zip(frames.number, frames.place, captions, strict=True):
        frame = cv2.cvtColor(frames.frames[int(place)], cv2.COLOR_RGB2BGR)
        pen = Pen.of(frame)
        first, start, end = np.searchsorted(drawing.frame, [number - memory, number, number + 1])
        # In order of the boxes' lower edges: what is nearer to the camera is drawn over the rest.
        now = np.arange(start, end)[np.argsort(drawing.box[start:end, 3], kind="stable")]
        recent = np.arange(first, end)
        if len(now):
            recent = recent[drawing.camera[recent] == drawing.camera[now[0]]]
        _draw_trails(frame, drawing, recent, pen, (float(number), memory))
        for row in now.tolist():
            _draw_box(frame, drawing, row, pen)
        for row in now[drawing.numbered[now]].tolist():
            _draw_number(frame, drawing, row, pen)
        if caption:
            _draw_caption(frame, caption, pen)
        yield frame


@dataclass(frozen=True, eq=False)
class Drawing:
    """n boxes in order of frames, and how each is drawn.

    Args:
        frame: (n,) the number of the frame.
        camera: (n,) int64.
        number: (n,) int64, 0 or more: the number at the box, which gives its colour.
        box: (n, 4) x1 y1 x2 y2 pixels, finite.
        dashed: (n,) bool, whether it was interpolated.
        numbered: (n,) bool, whether there is another box of its number; computed.
        color: (n, 3) BGR, 0..255, of each; computed.
    """

    frame: Any
    camera: Any
    number: Any
    box: Any
    dashed: Any
    numbered: Any = field(init=False)
    color: Any = field(init=False)

    def __post_init__(self) -> None:
        inverse, count = np.unique(self.number, return_inverse=True, return_counts=True)[1:]
        numbered = count[inverse] > 1
        color = np.where(numbered[:, None], colors(self.number), FADED)[:, ::-1]
        object.__setattr__(self, "numbered", numbered)
        object.__setattr__(self, "color", np.rint(color * 255).astype(int))

    @classmethod
    def of_tracks(cls, tracks: Tracks) -> Drawing:
        """Boxes of no observation are dashed, unless all are, as of tracks read from a file."""
        missing = tracks.observation < 0
        dashed = missing & (not missing.all())
        return cls(tracks.frame, tracks.camera, tracks.identity, tracks.box, dashed)


@dataclass(frozen=True)
class Pen:
    """Sizes that suit the frame: lines in pixels, letters in units of OpenCV's font."""

    line: int
    letters: float
    stroke: int
    gap: int

    @classmethod
    def of(cls, frame: np.ndarray) -> Pen:
        """Sizes grow with the frame's height, more slowly than it (power 0.8)."""
        scale = (frame.shape[0] / 480) ** 0.8
        return cls(
            line=max(1, round(1.6 * scale)),
            letters=max(0.4, 0.45 * scale),
            stroke=max(1, round(scale)),
            gap=max(2, round(3 * scale)),
        )


def _step(frames: NumberedFrames) -> float:
    """From one frame shown to the next."""
    return float(np.median(np.diff(frames.number))) if len(frames) > 1 else 1.0


def _draw_trails(
    frame: np.ndarray,
    drawing: Drawing,
    rows: np.ndarray,
    pen: Pen,
    clock: tuple[float, float],
) -> None:
    """Lines between successive foot points of each identity, fainter with age.

    The clock is the current frame's number and by how much a number may be older to be drawn.
    """
    import cv2

    now, memory = clock
    rows = rows[np.argsort(drawing.number[rows], kind="stable")]
    foot = np.stack([drawing.box[rows, [[0], [2]]].mean(0), drawing.box[rows, 3]], 1)
    foot = _pixels(frame, foot)
    follows = np.flatnonzero(drawing.number[rows[1:]] == drawing.number[rows[:-1]])
    if not len(follows):
        return
    # Older lines first, so that newer ones lie on top; outlines under all of them.
    follows = follows[np.argsort(drawing.frame[rows[follows]], kind="stable")]
    age = (now - drawing.frame[rows[follows]]) / memory
    paint, cover = frame.copy(), np.zeros(frame.shape[:2], dtype=np.uint8)
    for outline in (2, 0):
        for k, faded in zip(follows, age, strict=True):
            ends = foot[k].tolist(), foot[k + 1].tolist()
            color = drawing.color[rows[k]] if not outline else SHADE * drawing.color[rows[k]]
            width = pen.line + 1 + outline
            cv2.line(paint, *ends, color.tolist(), width, cv2.LINE_AA)
            cv2.line(cover, *ends, round(255 * (1 - 0.9 * faded)), width, cv2.LINE_AA)
    lines, columns = np.flatnonzero(cover.max(1)), np.flatnonzero(cover.max(0))
    if not len(lines):
        return
    part = np.s_[lines[0] : lines[-1] + 1, columns[0] : columns[-1] + 1]
    share = cover[part][..., None].astype(np.float32) / 255
    frame[part] = np.rint(paint[part] * share + frame[part] * (1 - share)).astype(np.uint8)


def _draw_box(frame: np.ndarray, drawing: Drawing, row: int, pen: Pen) -> None:
    import cv2

    color = drawing.color[row].tolist()
    shade = [round(SHADE * value) for value in color]
    (x1, y1), (x2, y2) = _pixels(frame, drawing.box[row].reshape(2, 2)).tolist()
    if drawing.dashed[row]:
        around = [(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)]
        for paint, width in ((shade, pen.line + 2), (color, pen.line)):
            for start, end in _dashes(around, 4 * pen.gap):
                cv2.line(frame, start, end, paint, width, cv2.LINE_AA)
    elif not drawing.numbered[row]:
        cv2.rectangle(frame, (x1, y1), (x2, y2), color, pen.stroke, cv2.LINE_AA)
    else:
        cv2.rectangle(frame, (x1, y1), (x2, y2), shade, pen.line + 2, cv2.LINE_AA)
        cv2.rectangle(frame, (x1, y1), (x2, y2), color, pen.line, cv2.LINE_AA)


def _dashes(corners: list[tuple[int, int]], length: int) -> Iterator[tuple[list[int], list[int]]]:
    """The ends of dashes along a line through corners, as long as the gaps between them."""
    for start, end in pairwise(corners):
        size = float(np.hypot(end[0] - start[0], end[1] - start[1]))
        count = 2 * max(1, round(size / (2 * length))) + 1
        points = np.rint(np.linspace(start, end, count + 1)).astype(int).tolist()
        yield from ((points[k], points[k + 1]) for k in range(0, count, 2))


def _draw_number(frame: np.ndarray, drawing: Drawing, row: int, pen: Pen) -> None:
    """In a filled rectangle on the box's upper edge, moved into the frame if that is outside."""
    import cv2

    text, color = str(drawing.number[row]), drawing.color[row]
    font = cv2.FONT_HERSHEY_SIMPLEX
    (width, height), _ = cv2.getTextSize(text, font, pen.letters, pen.stroke)
    width, height = width + 2 * pen.gap, height + 2 * pen.gap
    left, bottom = _pixels(frame, drawing.box[row, :2]).tolist()
    left = int(np.clip(left - pen.line // 2, 0, max(frame.shape[1] - width, 0)))
    bottom = int(np.clip(bottom, height, frame.shape[0]))
    label = ((left, bottom - height), (left + width, bottom))
    cv2.rectangle(frame, *label, color.tolist(), cv2.FILLED)
    letters = DARK if float(color @ LUMA) > 150 else LIGHT
    place = (left + pen.gap, bottom - pen.gap)
    cv2.putText(frame, text, place, font, pen.letters, letters, pen.stroke, cv2.LINE_AA)


def _draw_caption(frame: np.ndarray, text: str, pen: Pen) -> None:
    """In the lower left corner, on a darkened background."""
    import cv2

    font = cv2.FONT_HERSHEY_SIMPLEX
    (width, height), _ = cv2.getTextSize(text, font, pen.letters, pen.stroke)
    background = frame[-height - 4 * pen.gap :, : width + 4 * pen.gap]
    background[:] = background // 3
    place = (2 * pen.gap, frame.shape[0] - 2 * pen.gap)
    cv2.putText(frame, text, place, font, pen.letters, LIGHT, pen.stroke, cv2.LINE_AA)


def _pixels(frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points x y as whole numbers; those far outside of the frame as far as OpenCV can draw."""
    height, width = frame.shape[:2]
    low, high = (-width, -height), (2 * width, 2 * height)
    return np.rint(np.clip(points, low, high)).astype(int)
