"""What a sequence says of itself, without labels: its detector, its camera, how its things move."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64

from mixer_torch.boxes import centred, sizes
from mixer_torch.tracking.camera_steps import (
    AT_REST,
    camera_step,
    moved,
    moving,
    mutual_best,
)

SCORE_LEVELS = 40
"""Bins of equal counts of scores; a monotone curve through them needs no more."""
CONTINUES_REACH = 0.6
"""Sizes, within which a box of the next frame continues one, mutual best partners only."""
LEAST, MOST = 0.004, 0.5
"""Bounds of measured motion, shares of a box's size a frame: less than any detector's jitter, and
more than which boxes cannot be linked at all."""
ENOUGH = 20
"""Links from which a motion is measured; with fewer, it is a common one."""
COMMON_MOTION, COMMON_CHANGE = 0.05, 0.03
"""Sizes a frame: what is taken to be measured where there is nothing to measure it on."""
PRIOR_CONTINUES, PRIOR_WEIGHT = 0.9, 5.0
"""What a score is taken to mean before anything is known, and how many detections count as much."""
CONTINUITY_WEIGHT = 20.0  # detections that the same prior counts as for the whole sequence


@dataclass(frozen=True)
class Sequence:
    """Detections of one camera, in order of frames, in units of the median size of a box.

    Args:
        frames: (T,) int64, every frame from the first to the last one; every second one alone, say,
            where all frames with detections are so many apart or a multiple of it.
        start: (T + 1,) int64: rows start[t] to start[t + 1] - 1 are of frame t.
        box: (n, 4) float64 cx cy w h.
        score: (n,) float64, any scale on which more is better.
        unit: Pixels of the unit of length.
        category: (n,) int64.
    """

    frames: Int64[np.ndarray, " T"]
    start: Int64[np.ndarray, " T1"]
    box: Float64[np.ndarray, "n 4"]
    score: Float64[np.ndarray, " n"]
    unit: float
    category: Int64[np.ndarray, " n"]

    @classmethod
    def of(
        cls,
        frame: np.ndarray,
        corners: np.ndarray,
        score: np.ndarray | None = None,
        category: np.ndarray | None = None,
        unit: float | None = None,
    ) -> Sequence:
        """From boxes x1 y1 x2 y2 in order of frames; all scores alike where there are none, and a
        score that is not known (NaN) is taken to be the middle one.
        """
        n = len(frame)
        frames = np.zeros(0, dtype=np.int64)
        if n:
            frames = np.arange(frame[0], frame[-1] + 1, common_step(frame))
        start = np.append(np.searchsorted(frame, frames), n)
        box = centred(corners.astype(np.float64))
        if unit is None:
            unit = float(np.median(sizes(box))) if n else 1.0
        score = np.ones(n) if score is None else known_scores(np.asarray(score, dtype=np.float64))
        category = np.zeros(n, dtype=np.int64) if category is None else category
        return cls(frames, start, box / unit, score, unit, category)

    @property
    def step(self) -> int:
        """From one of ``frames`` to the next."""
        return int(self.frames[1] - self.frames[0]) if len(self.frames) > 1 else 1

    @property
    def frame(self) -> Int64[np.ndarray, " n"]:
        """(n,) the index in ``frames`` of each row."""
        return np.repeat(np.arange(len(self.frames)), np.diff(self.start))

    def rows(self, t: int) -> slice:
        """The rows of the t-th frame."""
        return slice(self.start[t], self.start[t + 1])


@dataclass(frozen=True)
class Measured:
    """All that is measured of a sequence; print it to see what was found.

    Args:
        levels: (k,) scores, ascending.
        meaning: (k,) how often detections of such a score go on in the frames beside theirs.
        motion: How far a box moves in a frame, sizes (median, with the camera's motion taken out).
        change: How much that differs from the frame before (median): jitter and turns together.
        jitter: Standard deviation of the centre of a detected box, sizes.
        clutter: Detections a frame that go on in neither frame beside theirs.
        continuity: Log odds that what was there in the last frame is there in the next: low where
            a detector misses much, or things come and go.
        camera: (T, 3) the similarity from the frame before: scale, and shift in boxes' units.
        links: How many pairs of boxes of successive frames these figures are of.
        unit: Pixels of the unit of length.
        density: Detections a frame.
    """

    levels: Float64[np.ndarray, " k"]
    meaning: Float64[np.ndarray, " k"]
    motion: float
    change: float
    jitter: float
    clutter: float
    continuity: float
    camera: Float64[np.ndarray, "T 3"] = field(repr=False)
    links: int
    unit: float
    density: float = 0.0

    @property
    def alone(self) -> float:
        """The share of the detections that go on in neither frame beside theirs."""
        return self.clutter / max(self.density, 1e-9)

    @property
    def camera_moves(self) -> float:
        """The share of frames in which the camera moves."""
        return float((self.camera[1:] != AT_REST).any(1).mean()) if len(self.camera) > 1 else 0.0

    def means(self, score: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """(n,) how often a detection of this score goes on in the frames beside its own."""
        return meaning_of(score, self.levels, self.meaning)

    def rank(self, score: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """(n,) where a score stands among all, from 0 to 1; 0.5 where all are alike."""
        if len(self.levels) < 2:
            return np.full(len(score), 0.5)
        return np.interp(score, self.levels, (np.arange(len(self.levels)) + 0.5) / len(self.levels))

    @property
    def summary(self) -> str:
        """One line of it."""
        if self.links < ENOUGH:
            return "too few boxes go on to measure anything, so what is usual is taken"
        moves = f"camera moves in {self.camera_moves:.0%} of the frames"
        camera = moves if self.camera_moves else "camera rests"
        return (
            f"{camera}, motion {self.motion:.3f} and jitter {self.jitter:.3f} of a box's size a "
            f"frame, {self.clutter:.2f} detections a frame go on nowhere"
        )

    def __str__(self) -> str:
        moves = self.camera[(self.camera != AT_REST).any(1)]
        shift = np.hypot(*moves[:, 1:].T) * self.unit
        camera = (
            f"moves in {self.camera_moves:.0%} of the frames, typically by {np.median(shift):.1f} "
            "pixels a frame"
            if self.camera_moves
            else "rests"
        )
        if len(self.levels) > 1:
            shown = np.linspace(0, len(self.levels) - 1, 5).round().astype(int)
            scores = ", ".join(f"{self.levels[k]:.3g}: {self.meaning[k]:.0%}" for k in shown)
        else:
            scores = "all alike" if len(self.levels) else "none"
        goes_on = 1 / (1 + np.exp(-self.continuity))
        return "\n".join(
            [
                f"camera    {camera}",
                f"motion    {self.motion:.3f} of a box's size a frame, changing by "
                f"{self.change:.3f}",
                f"jitter    {self.jitter:.3f} of a box's size",
                f"scores    goes on in the frames beside: {scores}",
                f"continues {goes_on:.1%} of what went on before goes on",
                f"clutter   {self.clutter:.2f} detections a frame go on in neither",
                f"measured  on {self.links:,} links of boxes of {self.unit:.0f} pixels",
            ]
        )


def common_step(frame: Int64[np.ndarray, " n"]) -> int:
    """The largest step of which all frame numbers, ascending, are multiples apart.

    Two frames alone say nothing of a step: it is 1.
    """
    apart = np.diff(np.unique(frame))
    return int(np.gcd.reduce(apart)) if len(apart) > 1 else 1


def known_scores(score: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Scores of which those that are not known (NaN) are the median of the others."""
    unknown = np.isnan(score)
    if not unknown.any():
        return score
    middle = 1.0 if unknown.all() else float(np.median(score[~unknown]))
    return np.where(unknown, middle, score)


def measure(sequence: Sequence, camera: Float64[np.ndarray, "T 3"] | None = None) -> Measured:
    """Measure a sequence: camera and links, then what scores mean, and both once more.

    Args:
        sequence: The detections.
        camera: The camera's steps, in the units of the sequence, where they are known.
    """
    n = len(sequence.box)
    weight = np.ones(n)
    for _ in range(2):
        steps = camera_steps(sequence, weight) if camera is None else camera
        forward, backward = continuations(sequence, steps)
        levels, meaning = score_meaning(sequence, forward, backward)
        means = meaning_of(sequence.score, levels, meaning)
        weight = np.clip(means, 0.02, 1) ** 2
    motion, change, jitter, links = motion_of(sequence, steps, forward, means > 0.6)
    count = max(len(sequence.frames), 1)
    alone = float(((forward < 0) & (backward < 0)).sum()) / count
    goes_on = continuity(sequence, forward, backward)
    return Measured(
        levels, meaning, motion, change, jitter, alone, goes_on, steps, links, sequence.unit,
        n / count,
    )  # fmt: skip


def meaning_of(score: np.ndarray, levels: np.ndarray, meaning: np.ndarray) -> np.ndarray:
    """(n,) how often a detection of this score goes on, by the levels found."""
    if not len(levels):
        return np.full(len(score), PRIOR_CONTINUES)
    return np.interp(score, levels, meaning)


def continuity(
    sequence: Sequence, forward: Int64[np.ndarray, " n"], backward: Int64[np.ndarray, " n"]
) -> float:
    """Log odds that a detection that goes on from the frame before goes on to the next, too."""
    known = (backward >= 0) & (sequence.frame < len(sequence.frames) - 1)
    weight = known.sum() + CONTINUITY_WEIGHT
    share = ((forward[known] >= 0).sum() + PRIOR_CONTINUES * CONTINUITY_WEIGHT) / weight
    share = min(share, 1 - 1 / weight)
    return float(np.log(share / (1 - share)))


def camera_steps(
    sequence: Sequence, weight: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "T 3"]:
    """(T, 3) the camera's step from the frame before; the first rests."""
    count = max(len(sequence.frames), 1)
    steps, gain, links = np.tile(AT_REST, (count, 1)), np.zeros(count), np.zeros(count, np.int64)
    previous = np.zeros(2)
    for t in range(1, len(sequence.frames)):
        a, b = sequence.rows(t - 1), sequence.rows(t)
        steps[t], gain[t], links[t] = camera_step(
            sequence.box[a], sequence.box[b], weight[a], weight[b], previous
        )
        previous = displacement_of(steps[t], sequence.box[b], previous)
    steps[~moving(gain, links)] = AT_REST
    return steps


def displacement_of(
    step: Float64[np.ndarray, " 3"], box: Float64[np.ndarray, "n 4"], previous: np.ndarray
) -> Float64[np.ndarray, " 2"]:
    """How far the middle of the boxes moves in a step of the camera; the last one without boxes."""
    return step[1:] + (step[0] - 1) * box[:, :2].mean(0) if len(box) else previous


def continuations(
    sequence: Sequence, steps: Float64[np.ndarray, "T 3"]
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """The row that each box goes on as in the next frame, and in the one before; -1 for none."""
    n = len(sequence.box)
    forward, backward = np.full(n, -1), np.full(n, -1)
    for t in range(1, len(sequence.frames)):
        a, b = sequence.rows(t - 1), sequence.rows(t)
        link = mutual_best(
            moved(sequence.box[a], steps[t]), sequence.box[b], np.zeros(2), CONTINUES_REACH
        )
        row = np.flatnonzero(link >= 0)
        forward[a.start + row] = b.start + link[row]
        backward[b.start + link[row]] = a.start + row
    return forward, backward


def score_meaning(
    sequence: Sequence, forward: Int64[np.ndarray, " n"], backward: Int64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """How often detections of a score go on in the frames beside, rising with the score.

    Only the order of scores counts, so that any scale will do. Frames at the ends have one frame
    beside them. Bins are of equal counts, and pooled until they rise (isotonic regression).

    Returns:
        (k,) scores and (k,) shares.
    """
    n, last = len(sequence.box), len(sequence.frames) - 1
    if not n:
        return np.zeros(0), np.zeros(0)
    frame = sequence.frame
    inner_next, inner_last = frame < last, frame > 0
    beside = inner_next.astype(float) + inner_last
    goes_on = ((forward >= 0) & inner_next).astype(float) + ((backward >= 0) & inner_last)
    order = np.argsort(sequence.score, kind="stable")
    _, first, count = np.unique(sequence.score[order], return_index=True, return_counts=True)
    middle = (first + count / 2) / n
    bin_of = np.minimum((middle * SCORE_LEVELS).astype(int), SCORE_LEVELS - 1)
    kept, bin_of = np.unique(bin_of, return_inverse=True)
    row_bin = np.repeat(bin_of, count)
    weight = np.bincount(row_bin, beside[order], len(kept))
    found = np.bincount(row_bin, goes_on[order], len(kept))
    share = (found + PRIOR_WEIGHT * PRIOR_CONTINUES) / (weight + PRIOR_WEIGHT)
    level = np.bincount(row_bin, sequence.score[order], len(kept)) / np.bincount(row_bin)
    return level, _rising(share, weight + PRIOR_WEIGHT)


def _rising(value: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The closest rising values (weighted least squares): isotonic regression by SciPy."""
    from scipy.optimize import isotonic_regression

    return isotonic_regression(value, weights=weight).x


def motion_of(
    sequence: Sequence,
    steps: Float64[np.ndarray, "T 3"],
    forward: Int64[np.ndarray, " n"],
    confident: np.ndarray,
) -> tuple[float, float, float, int]:
    """How far boxes move in a frame, by how much that changes, and jitter; all in sizes.

    Errors of boxes that are independent from frame to frame make second differences of variance
    6 jitter^2 over one frame and over two alike, while changes of velocity grow with the square of
    the time at least: with D1 and D2 the variances over steps of one and of two frames, and
    acceleration adding a and 16 a, jitter^2 = (16 D1 - D2) / 90.

    Returns:
        motion, change, jitter, and the number of links.
    """
    row = np.flatnonzero((forward >= 0) & confident)
    if len(row) < ENOUGH:
        row = np.flatnonzero(forward >= 0)
    if len(row) < ENOUGH:
        return COMMON_MOTION, COMMON_CHANGE, COMMON_CHANGE / 2, len(row)
    frame, size = sequence.frame, sizes(sequence.box)
    from_here = moved_rows(sequence.box, steps, frame)
    displacement = np.full((len(frame), 2), np.nan)
    has = np.flatnonzero(forward >= 0)
    displacement[has] = sequence.box[forward[has], :2] - from_here[has, :2]
    motion = np.median(np.hypot(*displacement[row].T) / size[row])
    second = displacement[forward[row]] - displacement[row]
    second = (second / size[row, None])[np.isfinite(second).all(1)]
    change = np.median(np.hypot(*second.T)) if len(second) > ENOUGH else motion
    jitter = _jitter(displacement / size[:, None], forward, row, change)
    bounded = np.clip([motion, change], LEAST, MOST)
    return float(bounded[0]), float(bounded[1]), jitter, len(row)


def moved_rows(box: np.ndarray, steps: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Each box as the camera of the frame after its own sees it."""
    step = steps[np.minimum(frame + 1, len(steps) - 1)]
    out = box * step[:, :1]
    out[:, :2] += step[:, 1:]
    return out


def _jitter(displacement: np.ndarray, forward: np.ndarray, row: np.ndarray, change: float) -> float:
    """From second differences over one frame and over two, see :func:`motion_of`."""

    def after(rows: np.ndarray) -> np.ndarray:
        return np.where(rows >= 0, forward[rows], -1)

    chain = [row]
    for _ in range(3):
        chain.append(after(chain[-1]))
    whole = chain[3] >= 0
    steps = [displacement[rows[whole]] for rows in chain]
    one = steps[1] - steps[0]
    two = steps[3] + steps[2] - steps[1] - steps[0]
    good = np.isfinite(one).all(1) & np.isfinite(two).all(1)
    if good.sum() < ENOUGH:
        return change / 3
    robust = 1.4826**2  # from the square of the median deviation to a normal's variance
    variance = [robust * np.median(np.abs(d[good])) ** 2 for d in (one, two)]
    return float(np.sqrt(max(16 * variance[0] - variance[1], 0.0) / 90))
