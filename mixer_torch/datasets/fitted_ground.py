"""The ground of a camera from a table of truth: where true boxes stand, in pixels and in metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from mixer_torch.boxes import corners, foot_points
from mixer_torch.extras import require
from mixer_torch.io.files import read_text
from mixer_torch.io.motchallenge import BOX, read_truth

GROUND_COLUMNS = slice(7, 9)
COLUMNS = 10
"""Of tables of MOT15; those with nine columns have a class where the ground positions were."""
UNKNOWN = -1.0
NEAR = 0.3
"""Metres from its true position within which a foot point agrees with a homography."""
FEWEST = 4
STANDS_OUT = 3.0
"""How much worse than the best fit any fit that is orthogonal to it has to be."""
SINGULAR = 1e-6


def is_truth(path: Path) -> bool:
    """Whether a file is a table of true boxes rather than a matrix of nine numbers."""
    text = read_text(path).strip()
    columns = text.partition("\n")[0].count(",") + 1
    return columns >= COLUMNS - 1 and len(text.replace(",", " ").split()) > 9


def fit_homography(path: Path) -> Float64[np.ndarray, "3 3"]:
    """The homography that takes the foot points of true boxes to their true ground positions.

    Annotated boxes and positions are both a little off, so a share of the points does not count
    (RANSAC); the others agree within :data:`NEAR`.

    Args:
        path: ``gt.txt`` of MOT15, whose columns 8 and 9 are X, Y in metres, -1 where not known.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is malformed, has positions of fewer than four boxes, or they are those of
            no homography (the camera moved), or of several (they lie on a line).
    """
    rows = read_truth(path, classes=None)
    if rows.shape[1] < COLUMNS:
        raise ValueError(
            f"{path}: expected ground positions X, Y in columns 8 and 9 of {COLUMNS}, "
            f"got {rows.shape[1]} columns"
        )
    ground = rows[:, GROUND_COLUMNS]
    known = np.isfinite(ground).all(1) & (ground != UNKNOWN).any(1)
    if len(rows) and not known.any():
        raise ValueError(
            f"{path}: expected ground positions in columns 8 and 9, all are {UNKNOWN:g} or NaN"
        )
    points, ground = foot_points(corners(rows[known, BOX])), ground[known]
    if len(points) < FEWEST:
        raise ValueError(
            f"{path}: expected ground positions of {FEWEST} boxes or more, got {len(points)}"
        )
    matrix, near = _agreed(points, ground)
    if 2 * near.sum() < len(points):
        raise ValueError(
            f"{path}: expected ground positions of one camera that stands still: a homography "
            f"explains {near.sum()} of {len(points)} within {NEAR} m"
        )
    if matrix is None or not _is_determined(points[near], ground[near]):
        raise ValueError(
            f"{path}: the ground positions of {len(points)} boxes lie on a line, or on so few "
            "places that they do not determine a homography"
        )
    return matrix


def _agreed(
    points: Float64[np.ndarray, "n 2"], ground: Float64[np.ndarray, "n 2"]
) -> tuple[np.ndarray | None, np.ndarray]:
    """The homography that most points agree with, None where none is found, and which do."""
    cv2 = require("cv2", extra="vision")

    matrix, near = cv2.findHomography(points, ground, cv2.RANSAC, NEAR)
    if matrix is None:
        return None, np.ones(len(points), dtype=bool)
    return matrix, near[:, 0].astype(bool)


def _is_determined(points: Float64[np.ndarray, "n 2"], ground: Float64[np.ndarray, "n 2"]) -> bool:
    """Whether H is the one solution of A h = 0, the linear equations (x, y, 1) x H (u, v, 1) = 0.

    It is where A's smallest singular value is far below the one before it, in coordinates of
    mean 0 and unit spread.
    """
    image = np.column_stack([_normalised(points), np.ones(len(points))])
    x, y = _normalised(ground).T
    none = np.zeros_like(image)
    equations = np.concatenate(
        [
            np.concatenate([image, none, -x[:, None] * image], 1),
            np.concatenate([none, image, -y[:, None] * image], 1),
        ]
    )
    value = np.zeros(9)
    found = np.linalg.svd(equations, compute_uv=False)
    value[: len(found)] = found  # 8 of them for 4 points
    return bool(value[7] > max(STANDS_OUT * value[8], SINGULAR * value[0]))


def _normalised(points: Float64[np.ndarray, "n 2"]) -> np.ndarray:
    centred = points - points.mean(0)
    return centred / (centred.std() or 1.0)
