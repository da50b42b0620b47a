"""What is done to the tracks of objects: gaps are filled, and boxes smoothed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from mixer_torch.tracks import Tracks

ROUGH = 0.005
"""Jitter, in sizes, up to which boxes are left as they are: that of boxes rounded to pixels."""


@dataclass(frozen=True)
class PostProcessing:
    """What is done to the tracks of objects.

    Args:
        object_odds: Log odds of being an object from which a track is one. Its default asks for
            more than an even chance: of a detector that the weights have not seen, the odds of
            clutter are underestimated.
        fill: Longest gap to be filled with boxes on a straight line, seconds; 0 for none.
        smoothing: Standard deviation in time of the average that boxes are replaced by, as a
            multiple of the best one for the measured jitter and change; 0 leaves boxes as they are.
    """

    object_odds: float = 1.0
    fill: float = 0.5
    smoothing: float = 0.0


def bandwidth(jitter: float, change: float) -> float:
    """Frames over which boxes are best averaged: where averaged jitter equals the bend of the path.

    A line fitted over n frames averages jitter s to about s / sqrt(n), and misses a path whose
    velocity changes by a in a frame by about a n^2 / 8: the sum is least near (4 s / a)^(2/5).

    Args:
        jitter: Standard deviation of boxes, sizes.
        change: Of the velocity from frame to frame, sizes, jitter not included.
    """
    if jitter <= ROUGH:
        return 0.0
    return float((4 * jitter / max(change, 1e-4)) ** 0.4)


def members(tracks: Tracks) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """The rows in order of track and frame, and which track each of them is of, from 0.

    A track is one identity in one camera.
    """
    order = np.lexsort((tracks.frame, tracks.camera, tracks.identity))
    key = np.stack([tracks.identity, tracks.camera])[:, order]
    change = (key[:, 1:] != key[:, :-1]).any(0)
    return order, np.concatenate([np.zeros(min(len(order), 1), int), np.cumsum(change)])


def interpolated(tracks: Tracks, max_gap: float, step: int = 1) -> Tracks:
    """Tracks with boxes in the frames that they miss, on a straight line between their neighbours.

    Args:
        tracks: What was found.
        max_gap: Frames between two neighbours, at most, for what is between them to be filled.
        step: From one frame of the sequence to the next: no others are filled.
    """
    order, track = members(tracks)
    frame = tracks.frame[order]
    apart = frame[1:] - frame[:-1]
    missing = np.where((track[1:] == track[:-1]) & (apart <= max_gap), apart // step - 1, 0)
    before = np.repeat(np.arange(len(missing)), missing)
    place = 1 + np.arange(len(before)) - np.repeat(np.cumsum(missing) - missing, missing)
    left, right = order[before], order[before + 1]
    share = place / (missing[before] + 1)
    box = tracks.box[left] + share[:, None] * (tracks.box[right] - tracks.box[left])
    confidence = np.minimum(tracks.confidence[left], tracks.confidence[right])
    return Tracks(
        np.concatenate([tracks.frame, tracks.frame[left] + place * step]),
        np.concatenate([tracks.identity, tracks.identity[left]]),
        np.concatenate([tracks.box, box]),
        np.concatenate([tracks.confidence, confidence]),
        np.concatenate([tracks.camera, tracks.camera[left]]),
        np.concatenate([tracks.observation, np.full(len(left), -1)]),
    )


def smoothed(tracks: Tracks, bandwidth: float) -> Tracks:
    """Tracks whose boxes are averages over time, each edge by local linear regression.

    The edge y of a box at frame t is the value at t of the line that fits the edges of its track
    best, by least squares with weights exp(-(t_i - t)^2 / (2 bandwidth^2)).

    Args:
        tracks: What was found.
        bandwidth: Of the weights, frames; 0 leaves all as it is.
    """
    if bandwidth <= 0 or not len(tracks):
        return tracks
    order, track = members(tracks)
    frame, box = tracks.frame[order].astype(np.float64), tracks.box[order]
    sums = np.zeros((len(order), 3))
    products = np.zeros((len(order), 2, 4))
    for offset in range(-int(np.ceil(3 * bandwidth)), int(np.ceil(3 * bandwidth)) + 1):
        here = np.arange(max(0, -offset), max(0, len(order) - max(0, offset)))
        here = here[track[here] == track[here + offset]]
        apart = frame[here + offset] - frame[here]
        weight = np.exp(-0.5 * (apart / bandwidth) ** 2)
        powers = weight[:, None] * apart[:, None] ** np.arange(3)
        sums[here] += powers
        products[here] += powers[:, :2, None] * box[here + offset, None]
    fitted = np.empty_like(tracks.box)
    fitted[order] = _line_at_zero(sums, products)
    return Tracks(
        tracks.frame,
        tracks.identity,
        fitted,
        tracks.confidence,
        tracks.camera,
        tracks.observation,
    )


def _line_at_zero(
    sums: Float[np.ndarray, "n 3"], products: Float[np.ndarray, "n 2 4"]
) -> Float[np.ndarray, "n 4"]:
    """The intercepts of weighted lines; the means where all weight is on one abscissa."""
    weight, first, second = (column[:, None] for column in sums.T)
    determinant = weight * second - first**2
    flat = determinant <= 1e-9 * weight**2
    line = second * products[:, 0] - first * products[:, 1]
    return np.where(flat, products[:, 0] / weight, line / np.where(flat, 1.0, determinant))
