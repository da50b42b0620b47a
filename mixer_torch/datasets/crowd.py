"""A crowd on foot, simulated: detections of any number of people over any number of frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from mixer_torch.boxes import area, intersection
from mixer_torch.datasets.base import Dataset, check_positive, check_source, observations_of
from mixer_torch.observations import Observations

WIDTH, HEIGHT, FOCAL = 1920, 1080, 1600.0  # of the picture, pixels
CAMERA_HEIGHT = 8.0  # metres; the camera is level, and its horizon the picture's upper edge
NEAR, FAR = FOCAL * CAMERA_HEIGHT / HEIGHT, 50.0  # metres from the camera: feet in the picture
STATURE, STATURE_SPREAD = 1.72, 0.08  # metres
BREADTH, BREADTH_SPREAD = 0.41, 0.05  # width of a box by its height
SPEED, SPEED_SPREAD = 1.3, 0.3  # metres a second
TURN = 0.25  # radians a second, at first; grows with the square root of time
PAUSES, RESUMES = 0.02, 0.3  # of those who walk, of those who stand: share that changes a second
SIDEWAYS = 0.8  # share of those who enter at the left or right
HIDDEN, PLAIN = 0.2, 0.6  # visible share up to which nobody is detected; from which all equally


@dataclass(eq=False)
class Crowd(Dataset):
    """People who walk, stop, turn, leave and enter, seen by a camera on a mast; boxes only.

    For tests of trackers at any length and density, with everything known. The ground before a
    level camera of 1920 x 1080 pixels, 8 m high, from 12 to 50 m; there are always ``num_people``
    on it, as for each one who leaves another one enters. A detection is the projected box with
    noise. Who is hidden by nearer people is missed, the more the less is visible, and confidence
    falls with it; clutter is of the size that people have at its place.

    Each frame is one view. Features: ``frame``, from 1; ``time``, (frame - 1) / frame_rate;
    ``camera``, 0; ``box``; ``confidence``, 0.5 to 1, spread like that
    of Faster R-CNN on MOT15; ``identity``, from 1, -1 for clutter.

    Args:
        num_people: On the ground in each frame.
        num_frames: Frames.
        frame_rate: Frames a second.
        box_jitter: Standard deviation of a box's edges, as a share of its width and height.
        miss_rate: Probability that a person in plain view is not detected.
        clutter: Mean number of false detections a frame.
        seed: Of every draw. The people walk the same way whatever the three arguments above it.
        source: Observe detections, or the true boxes of all who are there, hidden ones too.

    Raises:
        ValueError: An argument is out of its range.
    """

    num_people: int = 50
    num_frames: int = 1000
    frame_rate: float = 25.0
    box_jitter: float = 0.03
    miss_rate: float = 0.1
    clutter: float = 3.0
    seed: int = 0
    source: Literal["det", "gt"] = "det"

    def __post_init__(self) -> None:
        for name in ("num_people", "num_frames", "seed"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 0:
                raise ValueError(f"{name}: expected an integer of 0 or more, got {value!r}")
        check_positive(frame_rate=self.frame_rate)
        for name, most in (("box_jitter", 1.0), ("miss_rate", 1.0), ("clutter", 1e6)):
            if not 0 <= (number := getattr(self, name)) <= most:
                raise ValueError(f"{name}: expected a number from 0 to {most:g}, got {number}")
        check_source(self.source)

    def load(self) -> Observations:
        walking, seeing = (np.random.default_rng([self.seed, k]) for k in range(2))
        people = _people_anywhere(self.num_people, walking)
        rows = [np.empty((0, 7))]
        for frame in range(1, self.num_frames + 1):
            row = np.column_stack([_boxes(people), np.ones(self.num_people), people.identity])
            if self.source == "det":
                row = self._detect(row, people.depth, seeing)
            rows.append(np.column_stack([np.full(len(row), frame), row]))
            people = _walk_on(people, 1 / self.frame_rate, walking)
        table = np.concatenate(rows)
        number = table[:, 0].astype(np.int64)
        features: dict[str, np.ndarray] = {
            "frame": number,
            "time": (number - 1) / self.frame_rate,
            "camera": np.zeros_like(number),
            "box": table[:, 1:5].astype(np.float32),
            "confidence": table[:, 5].astype(np.float32),
            "identity": table[:, 6].astype(np.int64),
        }
        return observations_of(number, features)

    def _detect(
        self,
        truth: Float64[np.ndarray, "n 6"],
        depth: Float64[np.ndarray, " n"],
        generator: np.random.Generator,
    ) -> Float64[np.ndarray, "k 6"]:
        """What a detector makes of a frame: rows of box, confidence, identity in random order."""
        shown = visible_share(truth[:, :4], depth)
        odds = ((shown - HIDDEN) / (PLAIN - HIDDEN)).clip(0, 1) * (1 - self.miss_rate)
        found = truth.copy()
        found[:, 4] = 0.5 + 0.5 * generator.beta(12, 1 + 8 * (1 - shown))
        found = found[generator.random(len(truth)) < odds]
        strange = _people_anywhere(int(generator.poisson(self.clutter)), generator)
        doubtful = 0.5 + 0.5 * generator.beta(2, 1.5, len(strange.depth))
        clutter = np.column_stack([_boxes(strange), doubtful, np.full(len(doubtful), -1.0)])
        rows = generator.permutation(np.concatenate([found, clutter]))
        size = rows[:, 2:4] - rows[:, :2]
        jitter = generator.normal(0, self.box_jitter, (len(rows), 4)).clip(-0.4, 0.4)
        rows[:, :4] += jitter * np.concatenate([size, size], 1)
        return rows


def visible_share(
    box: Float64[np.ndarray, "n 4"], depth: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Of each box, the share that nearer ones leave free, as if they overlapped by chance."""
    covered = intersection(box, box) / area(box)[:, None]
    covered[depth[:, None] <= depth] = 0
    return (1 - covered.clip(max=1)).prod(1)


@dataclass(frozen=True)
class _People:
    """Who is on the ground. ``side`` and ``depth`` in metres, right of and from the camera."""

    side: np.ndarray
    depth: np.ndarray
    heading: np.ndarray  # radians, 0 to the right, pi / 2 away from the camera
    speed: np.ndarray
    walks: np.ndarray
    stature: np.ndarray
    breadth: np.ndarray
    identity: np.ndarray
    seen: int  # how many there have been so far


def _half_width(depth: np.ndarray) -> np.ndarray:
    """Metres of ground from the middle of the picture to its edge."""
    return depth * (WIDTH / 2 / FOCAL)


def _people_anywhere(n: int, generator: np.random.Generator) -> _People:
    """People uniformly on the ground that is seen; identities from 1."""
    depth = np.sqrt(generator.uniform(NEAR**2, FAR**2, n))
    return _People(
        side=generator.uniform(-1, 1, n) * _half_width(depth),
        depth=depth,
        heading=generator.uniform(0, 2 * np.pi, n),
        speed=generator.normal(SPEED, SPEED_SPREAD, n).clip(0.3),
        walks=generator.random(n) < RESUMES / (RESUMES + PAUSES),
        stature=generator.normal(STATURE, STATURE_SPREAD, n),
        breadth=generator.normal(BREADTH, BREADTH_SPREAD, n).clip(0.25),
        identity=np.arange(1, n + 1),
        seen=n,
    )


def _walk_on(people: _People, seconds: float, generator: np.random.Generator) -> _People:
    """The people a moment later; new ones in the place of those who left."""
    n = len(people.depth)
    step = people.speed * people.walks * seconds
    side = people.side + step * np.cos(people.heading)
    depth = people.depth + step * np.sin(people.heading)
    heading = people.heading + TURN * math.sqrt(seconds) * generator.normal(size=n)
    changes = generator.random(n) < np.where(people.walks, PAUSES, RESUMES) * seconds
    left = (np.abs(side) > _half_width(depth)) | (depth < NEAR) | (depth > FAR)
    fresh = _at_the_edge(_people_anywhere(n, generator), generator)
    rank = np.cumsum(left)
    return _People(
        side=np.where(left, fresh.side, side),
        depth=np.where(left, fresh.depth, depth),
        heading=np.where(left, fresh.heading, heading),
        speed=np.where(left, fresh.speed, people.speed),
        walks=left | (people.walks ^ changes),
        stature=np.where(left, fresh.stature, people.stature),
        breadth=np.where(left, fresh.breadth, people.breadth),
        identity=np.where(left, people.seen + rank, people.identity),
        seen=people.seen + int(left.sum()),
    )


def _at_the_edge(people: _People, generator: np.random.Generator) -> _People:
    """The same people where they enter, on their way in, at most 45 degrees off straight."""
    n = len(people.depth)
    right = np.sign(people.side)
    by_side = generator.random(n) < SIDEWAYS
    far = generator.random(n) < 0.5
    depth = np.where(by_side, people.depth, np.where(far, FAR, NEAR))
    side = np.where(by_side, right * _half_width(depth), people.side / people.depth * depth)
    inwards = np.where(by_side, np.where(right > 0, np.pi, 0.0), np.where(far, -1, 1) * np.pi / 2)
    heading = inwards + generator.uniform(-np.pi / 4, np.pi / 4, n)
    return _People(
        side, depth, heading, people.speed, people.walks, people.stature, people.breadth,
        people.identity, people.seen,
    )  # fmt: skip


def _boxes(people: _People) -> Float64[np.ndarray, "n 4"]:
    """What the camera sees of each: x1 y1 x2 y2, pixels, beyond the picture's edge too."""
    scale = FOCAL / people.depth
    middle = WIDTH / 2 + scale * people.side
    half = scale * people.stature * people.breadth / 2
    top, foot = scale * (CAMERA_HEIGHT - people.stature), scale * CAMERA_HEIGHT
    return np.column_stack([middle - half, top, middle + half, foot])
