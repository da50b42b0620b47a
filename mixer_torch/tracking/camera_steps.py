"""The camera's motion between two frames, from the boxes alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from mixer_torch.boxes import sizes

AT_REST = np.array([1.0, 0.0, 0.0])
"""The step of a camera that does not move: scale 1, shift 0."""
REACH = (1.5, 1.0)
"""How far a box may move between two frames for its pair to vote, in sizes, sideways and upwards;
nothing depends on it but how many pairs vote."""
VOTE_WIDTH = 0.08
"""Standard deviation of a vote, sizes: a few times the jitter of usual detectors."""
MOST_CANDIDATES = 150
REST_BONUS = 1.1
"""Votes of rest and of the last shift count a little more, as ties are common in small crowds."""
LINK_REACH = 0.35
"""Sizes, within which two boxes may be one thing once the common shift is taken out."""
FEWEST_LINKS = 3  # for a shift
FEWEST_FOR_SCALE = 6
LARGEST_SCALE_STEP = 0.05  # from a frame to the next
FINEST = 0.003
"""Sizes, which are no motion: less than any detector's jitter."""


WINDOW = 15
"""Frames over which it is decided whether a camera moves: half a second of usual video."""
LEAST_GAIN = 0.15
"""Nats a box by which the common motion has to explain boxes better than rest does."""


def moved(box: Float64[np.ndarray, "n 4"], step: Float64[np.ndarray, " 3"]) -> np.ndarray:
    """Boxes cx cy w h as the camera of the next frame sees them: scale times box, plus shift."""
    scale, *shift = step
    return box * scale + np.array([*shift, 0.0, 0.0])


def mutual_best(
    a: Float64[np.ndarray, "n 4"],
    b: Float64[np.ndarray, "m 4"],
    shift: Float64[np.ndarray, " 2"],
    reach: float,
) -> Int64[np.ndarray, " n"]:
    """For each box cx cy w h of a, moved by a shift, the box of b that it is best for, too.

    The distance is that of centres in units of the mean size, and of the logarithms of sides.

    Args:
        a: Boxes of the one frame.
        b: Boxes of the other.
        shift: To be added to a.
        reach: Distance at most.

    Returns:
        Indices in b, -1 for none.
    """
    n, m = len(a), len(b)
    if not n or not m:
        return np.full(n, -1)
    size = (sizes(a)[:, None] + sizes(b)) / 2
    offset = (b[:, :2] - a[:, None, :2] - shift) / size[:, :, None]
    growth = np.log(b[:, 2:] / a[:, None, 2:])
    distance = (offset**2).sum(2) + 0.5 * (growth**2).sum(2)
    best = distance.argmin(1)
    back = distance.argmin(0)
    rows = np.arange(n)
    mutual = (back[best] == rows) & (distance[rows, best] <= reach**2)
    return np.where(mutual, best, -1)


def camera_step(
    a: Float64[np.ndarray, "n 4"],
    b: Float64[np.ndarray, "m 4"],
    weight_a: Float64[np.ndarray, " n"],
    weight_b: Float64[np.ndarray, " m"],
    previous: Float64[np.ndarray, " 2"],
) -> tuple[Float64[np.ndarray, " 3"], float, int]:
    """The similarity that most boxes of a frame follow to the next: scale and shift.

    All pairs of boxes of about the same shape vote for their displacement; about the winner,
    mutual best partners give the shift (their median) and the scale (robust least squares with
    Cauchy weights). Where rest explains the links about as well, the camera rests.

    Args:
        a: Boxes cx cy w h of the one frame.
        b: Boxes of the next.
        weight_a: How much each counts, from 0 to 1: what its detector's score means.
        weight_b: Likewise.
        previous: Displacement of the step before, which is tried as well as rest.

    Returns:
        (scale, x, y): a point p of the one frame is at scale * p + (x, y) of the next; by how many
        nats it explains all links better than rest, where one half of the boxes tells the motion
        of the other; and the number of links.
    """
    if min(len(a), len(b)) < FEWEST_LINKS:
        return AT_REST, 0.0, 0
    shift = _common_shift(a, b, weight_a, weight_b, previous)
    for _ in range(2):
        link = mutual_best(a, b, shift, LINK_REACH)
        linked = link >= 0
        if linked.sum() < FEWEST_LINKS:
            return AT_REST, 0.0, 0
        displacement = b[link[linked], :2] - a[linked, :2]
        shift = np.median(displacement, 0)
    place, size = a[linked, :2], sizes(a[linked])
    growth, offset = 0.0, shift
    if len(place) >= FEWEST_FOR_SCALE:
        growth, offset = _growth_and_shift(place, displacement, size, shift)
    gain = _gain(displacement, size)
    return np.array([1 + growth, *offset]), gain * len(place), len(place)


def _gain(displacement: np.ndarray, size: np.ndarray) -> float:
    """Nats a link by which the median motion of the other half explains it better than rest."""
    half = np.arange(len(size)) % 2 == 0
    told = np.where(
        half[:, None], np.median(displacement[~half], 0), np.median(displacement[half], 0)
    )
    moves = np.median(np.hypot(*(displacement - told).T) / size)
    rests = np.median(np.hypot(*displacement.T) / size)
    return float(np.clip(np.log((rests + FINEST) / (moves + FINEST)), -2, 2))


def moving(gain: Float64[np.ndarray, " T"], links: Int64[np.ndarray, " T"]) -> np.ndarray:
    """(T,) whether the camera moves, by the mean gain over the frames around each."""
    around = np.ones(WINDOW)
    total = np.convolve(gain, around, "full")[WINDOW // 2 :][: len(gain)]
    count = np.convolve(links, around, "full")[WINDOW // 2 :][: len(gain)]
    return total > LEAST_GAIN * np.maximum(count, 1)


def _common_shift(
    a: np.ndarray, b: np.ndarray, weight_a: np.ndarray, weight_b: np.ndarray, previous: np.ndarray
) -> Float64[np.ndarray, " 2"]:
    """The displacement with most votes, one for each box of a."""
    size = sizes(a)[:, None]
    displacement = b[:, :2] - a[:, None, :2]
    change = np.abs(np.log(b[:, 2:] / a[:, None, 2:])).sum(2)
    near = np.abs(displacement) < np.array(REACH) * size[:, :, None]
    row, column = np.nonzero(near.all(2) & (change < 0.5))
    if len(row) < FEWEST_LINKS:
        return np.zeros(2)
    vote = displacement[row, column]
    weight = np.exp(-4 * change[row, column]) * weight_a[row] * weight_b[column]
    step = max(1, len(vote) // MOST_CANDIDATES)
    candidate = np.concatenate([np.zeros((1, 2)), previous[None], vote[::step]])
    apart = (vote - candidate[:, None]) / (VOTE_WIDTH * sizes(a)[row])[:, None]
    support = weight * np.exp(-0.5 * (apart**2).sum(2))
    first = np.flatnonzero(np.diff(row, prepend=-1))  # rows are in order: one vote for each box
    total = np.maximum.reduceat(support, first, axis=1).sum(1)
    total[0] *= REST_BONUS
    total[1] *= np.sqrt(REST_BONUS)
    return candidate[total.argmax()]


def _growth_and_shift(
    place: np.ndarray, displacement: np.ndarray, size: np.ndarray, shift: np.ndarray
) -> tuple[float, Float64[np.ndarray, " 2"]]:
    """Robust least squares of displacement = growth * place + shift."""
    growth, offset = 0.0, shift
    for _ in range(8):
        residual = (displacement - offset - growth * place) / (0.05 * size)[:, None]
        weight = (1 / (1 + (residual**2).sum(1)))[:, None]
        centre = (weight * place).sum(0) / weight.sum()
        mean = (weight * displacement).sum(0) / weight.sum()
        spread = (weight * (place - centre) ** 2).sum()
        common = (weight * (place - centre) * (displacement - mean)).sum()
        # a tenth more in the denominator: growth is shrunk, as things move along the view, too
        growth = float(np.clip(common / max(1.1 * spread, 1e-12), -1, 1) if spread > 0 else 0.0)
        growth = float(np.clip(growth, -LARGEST_SCALE_STEP, LARGEST_SCALE_STEP))
        offset = mean - growth * centre
    return growth, offset
