"""Tables of boxes of one camera, in the formats that there are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from mixer_torch.boxes import corners
from mixer_torch.io.files import read_json, read_text
from mixer_torch.io.motchallenge import BOX, read_table, read_truth
from mixer_torch.io.text import read_numbers, refuse, repeated

VATIC_COLUMNS = 9
MARGIN = 0.5
"""How far a box of the unit square may stand out of it, for people who are cut off."""


@dataclass(frozen=True)
class Boxes:
    """Boxes of one camera, one row each.

    Args:
        frame: (n,) int64, as the table counts.
        box: (n, 4) float64, x1 y1 x2 y2 in pixels.
        confidence: (n,) float64, 1 in tables that do not say.
        identity: (n,) int64, -1 where not known.
    """

    frame: Int64[np.ndarray, " n"]
    box: Float64[np.ndarray, "n 4"]
    confidence: Float64[np.ndarray, " n"]
    identity: Int64[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, rows: Any) -> Boxes:
        """The rows of a mask or of indices, in their order."""
        return Boxes(self.frame[rows], self.box[rows], self.confidence[rows], self.identity[rows])


def read_boxes(path: Path, truth: bool = False) -> Boxes:
    """Read a table in the format that its name and its first line tell, packed (``.gz``) or not.

    ========================= =====================================================================
    ``.json``                 ``{"video_info": {"width", "height"}, "frames": [{"frame_number",
                              "detections": [{"bbox": {"left", "top", "right", "bottom"},
                              "confidence"}]}]}``, boxes in parts of the width and the height
    lines with a quoted word  VATIC: identity, x1, y1, x2, y2, frame, lost, occluded, generated,
                              "label", apart by spaces; lines that are lost are left out
    any other lines           MOTChallenge: frame, identity, left, top, width, height,
                              confidence, ..., apart by commas
    ========================= =====================================================================

    Args:
        path: The file.
        truth: Whether it is a table of true boxes: then it has identities, and of MOTChallenge
            lines those count whose seventh number is not 0.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is malformed; the message names the file and the line or the frame.
    """
    if path.name.lower().removesuffix(".gz").endswith(".json"):
        boxes = _read_json(path)
    elif '"' in read_text(path).lstrip().partition("\n")[0]:
        boxes = _read_vatic(path)
    else:
        rows = read_truth(path) if truth else read_table(path)[0]
        ones = np.ones(len(rows))
        frame, identity = rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64)
        return Boxes(frame, corners(rows[:, BOX]), ones if truth else rows[:, 6], identity)
    if truth and (boxes.identity < 0).any():
        raise ValueError(f"{path}: expected a table of true boxes, got one without identities")
    return boxes


def _read_vatic(path: Path) -> Boxes:
    """Lines of C. Vondrick's annotation tool VATIC."""
    rows, number = read_numbers(path, VATIC_COLUMNS, label='"')
    refuse(path, number, ~np.isfinite(rows).all(1), "a number is not finite")
    refuse(path, number, (rows[:, [0, 5]] < 0).any(1), "expected an identity and a frame from 0")
    refuse(path, number, (rows[:, [0, 5]] % 1 != 0).any(1), "identity or frame is not whole")
    rows, number = rows[rows[:, 6] == 0], number[rows[:, 6] == 0]
    refuse(path, number, (rows[:, 3:5] <= rows[:, 1:3]).any(1), "expected x1 < x2 and y1 < y2")
    refuse(path, number, repeated(rows[:, [0, 5]]), "this identity is in this frame already")
    identity, frame = rows[:, 0].astype(np.int64), rows[:, 5].astype(np.int64)
    return Boxes(frame, rows[:, 1:5], np.ones(len(rows)), identity)


def _read_json(path: Path) -> Boxes:
    """Frames with lists of detections, boxes in parts of the picture's width and height."""
    rows: list[list[float]] = []
    place = "video_info"
    found = read_json(path)
    try:
        size = found["video_info"]
        width, height = float(size["width"]), float(size["height"])
        for k, frame in enumerate(found["frames"]):
            place = f"frames[{k}]"
            number = float(frame["frame_number"])
            for detection in frame["detections"]:
                sides = (detection["bbox"][side] for side in ("left", "top", "right", "bottom"))
                rows.append([number, *map(float, sides), float(detection["confidence"])])
    except KeyError as error:
        raise ValueError(f"{path}: {place}: {error} is missing") from None
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {place}: {error}") from None
    table = np.array(rows).reshape(-1, 6)
    frame, box = table[:, 0], table[:, 1:5]
    _refuse(path, frame, ~np.isfinite(table).all(1), "a number is not finite")
    _refuse(path, frame, (frame < 0) | (frame % 1 != 0), "expected a frame number from 0")
    outside = ((box < -MARGIN) | (box > 1 + MARGIN)).any(1)
    _refuse(path, frame, outside, "expected a box in parts of the picture, 0 to 1")
    _refuse(path, frame, (box[:, 2:] <= box[:, :2]).any(1), "expected left < right, top < bottom")
    scale = np.array([width, height, width, height])
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise ValueError(f"{path}: video_info: expected a width and a height, got {scale[:2]}")
    unknown = np.full(len(table), -1, dtype=np.int64)
    return Boxes(frame.astype(np.int64), box * scale, table[:, 5], unknown)


def _refuse(path: Path, frame: Float64[np.ndarray, " n"], wrong: Any, message: str) -> None:
    """ValueError that names the file and the first frame that is wrong, if any is."""
    if np.any(wrong):
        raise ValueError(f"{path}: frame_number {frame[np.argmax(wrong)]:g}: {message}")
