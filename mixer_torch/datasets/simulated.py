"""Sequences of things that move before a camera that may move: simulated widely, with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64, Int64

from mixer_torch.datasets.base import Dataset
from mixer_torch.datasets.crowd import visible_share
from mixer_torch.observations import Observations

WIDTH, HEIGHT = 1920.0, 1080.0  # of the picture, pixels
FOCAL = 1200.0  # of the camera at rest, pixels
NEAR, FAR = 4.0, 40.0  # of what is on the ground, metres from the camera
CORRELATION = 0.8  # of a detector's error from one frame to the next


@dataclass(frozen=True)
class Scene:
    """What is seen, by what: the settings of :class:`Simulated`.

    Args:
        frames: How many.
        frame_rate: Frames a second.
        things: Mean number of things in the picture.
        stature: Mean height of a thing, metres.
        breadth: Mean width of a box by its height.
        speed: Typical speed of a thing, its own heights a second.
        turning: How fast velocities change: the inverse of the time after which a velocity is
            forgotten, 1 / seconds.
        swaying: Amplitude of a fast movement about the path, heights; dancers have much of it.
        pan: Typical speed of the camera's turning, pixels a frame.
        zoom: Typical change of scale, nats a frame.
        drive: Speed of the camera along the ground, metres a second.
        shake: Standard deviation of a fast movement of the picture, pixels.
        jitter: Standard deviation of the edges of a detected box, shares of its size.
        miss: Probability that a thing in plain view is not detected.
        clutter: Mean number of false detections a frame.
        ghosts: Mean life of a false detection, frames: it stays at its place.
        hidden: Visible share below which a thing is not detected.
        hardly_scored: How much lower the score of a detection is, in logits, where a thing is
            hardly seen.
        truth_of_hidden: Whether the truth has boxes of things that are hidden.
    """

    frames: int = 300
    frame_rate: float = 25.0
    things: float = 12.0
    stature: float = 1.7
    breadth: float = 0.4
    speed: float = 0.8
    turning: float = 0.3
    swaying: float = 0.0
    pan: float = 0.0
    zoom: float = 0.0
    drive: float = 0.0
    shake: float = 0.0
    jitter: float = 0.02
    miss: float = 0.05
    clutter: float = 0.5
    ghosts: float = 2.0
    hidden: float = 0.3
    hardly_scored: float = 4.0
    truth_of_hidden: bool = True

    @classmethod
    def drawn(cls, seed: int) -> Scene:
        """A scene drawn widely: walkers, players, dancers and cars, cameras and detectors."""
        rng = np.random.default_rng([seed, 7])

        def between(low: float, high: float) -> float:
            return float(np.exp(rng.uniform(np.log(low), np.log(high))))

        def sometimes(share: float, low: float, high: float) -> float:
            return between(low, high) if rng.random() < share else 0.0

        car = rng.random() < 0.25
        return cls(
            frames=int(between(150, 500)),
            frame_rate=between(6, 40),
            things=between(3, 45),
            stature=1.5 if car else 1.7,
            breadth=between(1.0, 2.2) if car else between(0.3, 0.6),
            speed=between(0.2, 4.0),
            turning=between(0.05, 3.0),
            swaying=sometimes(0.4, 0.02, 0.3),
            pan=sometimes(0.5, 0.5, 25.0),
            zoom=sometimes(0.3, 0.0005, 0.01),
            drive=sometimes(0.25, 1.0, 15.0),
            shake=sometimes(0.3, 0.3, 6.0),
            jitter=sometimes(0.85, 0.004, 0.06),
            miss=sometimes(0.85, 0.01, 0.35),
            clutter=sometimes(0.8, 0.05, 8.0),
            ghosts=between(1.0, 10.0),
            hidden=float(rng.uniform(0.05, 0.6)),
            hardly_scored=between(1.0, 8.0),
            truth_of_hidden=bool(rng.random() < 0.6),
        )


class Simulated(Dataset):
    """Boxes of a simulated sequence, with everything known.

    Things stand on a ground plane before a camera, and their velocities are an
    Ornstein-Uhlenbeck process; they enter and leave. What the camera at rest would see is then
    moved by one similarity a frame (:attr:`camera_path`). Who is hidden by nearer things is missed,
    and scores fall with what is visible. Errors of boxes are alike from frame to frame.

    Each frame is one view. Features: ``frame``, from 1; ``time``; ``camera``, 0; ``box``;
    ``confidence`` in (0, 1); ``identity``, -1 for clutter.

    Args:
        scene: What is seen; a scene drawn from the seed if None.
        seed: Of every draw.
        source: Observe detections, or the true boxes.

    Raises:
        ValueError: source is none of the two.
    """

    def __init__(
        self, scene: Scene | None = None, seed: int = 0, source: Literal["det", "gt"] = "det"
    ) -> None:
        if source not in ("det", "gt"):
            raise ValueError(f"source: expected 'det' or 'gt', got {source!r}")
        self.scene = scene or Scene.drawn(seed)
        self.seed, self.source = seed, source

    def load(self) -> Observations:
        scene = self.scene
        place, identity = _ground_paths(scene, np.random.default_rng([self.seed, 0]))
        box, depth, frame, identity = _seen(scene, place, identity, self.seed)
        box = self._moved(box, frame)
        inside = _inside(box)
        box, depth, frame, identity = box[inside], depth[inside], frame[inside], identity[inside]
        share = _visible(box, depth, frame, scene.frames)
        if self.source == "gt":
            keep = np.full(len(box), True) if scene.truth_of_hidden else share > scene.hidden
            return _observations(scene, frame[keep], box[keep], np.ones(keep.sum()), identity[keep])
        return self._detected(box, share, frame, identity)

    @property
    def camera_path(self) -> Float64[np.ndarray, "T 3"]:
        """(T, 3) scale s and shift t of each frame: a point x of the resting camera is at s x + t,
        with x and t in pixels, from the middle of the picture.
        """
        scene, rng = self.scene, np.random.default_rng([self.seed, 1])
        steady = min(1.0, 1.0 / scene.frame_rate)  # speeds of a camera last about a second
        speed = np.zeros(3)
        path = np.zeros((scene.frames, 3))
        for t in range(1, scene.frames):
            speed += steady * -speed + np.sqrt(2 * steady) * rng.normal(size=3)
            path[t] = path[t - 1] + speed * (scene.zoom, scene.pan, 0.2 * scene.pan)
            path[t] *= 0.995  # what is filmed stays in the middle, by and by
        path[:, 1:] += scene.shake * rng.normal(size=(scene.frames, 2))
        path[:, 0] = np.exp(path[:, 0])
        return path

    def _moved(self, box: np.ndarray, frame: np.ndarray) -> np.ndarray:
        path = self.camera_path[frame]
        middle = np.array([WIDTH, HEIGHT, WIDTH, HEIGHT]) / 2
        return (box - middle) * path[:, :1] + path[:, [1, 2, 1, 2]] + middle

    def _detected(
        self, box: np.ndarray, share: np.ndarray, frame: np.ndarray, identity: np.ndarray
    ) -> Observations:
        """What the detector makes of true boxes, in order of frames."""
        scene, rng = self.scene, np.random.default_rng([self.seed, 2])
        seen = ((share - scene.hidden) / max(1 - scene.hidden, 1e-9)).clip(0, 1)
        odds = (1 - scene.miss) * np.sqrt(seen)
        found = rng.random(len(box)) < odds
        error = _alike(rng.normal(size=(len(box), 4)), identity, frame)
        size = box[:, 2:] - box[:, :2]
        rough = scene.jitter * (1 + 2 * (1 - seen))[:, None]
        noisy = box + rough * error * np.concatenate([size, size], 1)
        logit = 2.5 - scene.hardly_scored * (1 - seen) + 0.7 * rng.normal(size=len(box))
        ghost_frame, ghost, ghost_logit = self._ghosts(box, rng)
        frames = np.concatenate([frame[found], ghost_frame])
        boxes = np.concatenate([noisy[found], ghost])
        score = 1 / (1 + np.exp(-np.concatenate([logit[found], ghost_logit])))
        who = np.concatenate([identity[found], np.full(len(ghost), -1)])
        order = np.lexsort((rng.random(len(frames)), frames))
        return _observations(scene, frames[order], boxes[order], score[order], who[order])

    def _ghosts(
        self, box: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """False detections, of the size of some true box, which stay for a while."""
        scene = self.scene
        if not len(box):
            return np.zeros(0, dtype=np.int64), np.zeros((0, 4)), np.zeros(0)
        count = rng.poisson(scene.clutter * scene.frames / scene.ghosts)
        life = rng.geometric(1 / scene.ghosts, count)
        frame = np.repeat(rng.integers(0, scene.frames, count), life)
        frame += np.concatenate([np.arange(n) for n in life] or [np.zeros(0, dtype=np.int64)])
        like = box[rng.integers(0, len(box), count)]
        shift = rng.normal(size=(count, 2)) * (like[:, 2:] - like[:, :2]) * (1.0, 0.5)
        like = like + np.concatenate([shift, shift], 1)
        ghost = np.repeat(like, life, 0)
        size = ghost[:, 2:] - ghost[:, :2]
        noise = 2 * scene.jitter * rng.normal(size=ghost.shape) * np.concatenate([size, size], 1)
        logit = np.repeat(rng.normal(-1.5, 1.0, count), life) + 0.5 * rng.normal(size=len(ghost))
        keep = frame < scene.frames
        return frame[keep], (ghost + noise)[keep], logit[keep]


def _ground_paths(
    scene: Scene, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "T n 2"], Int64[np.ndarray, "T n"]]:
    """Where things are, sideways and away from the camera, metres; identities change where a new
    thing takes the place of one that left.
    """
    n = max(1, rng.poisson(scene.things * 1.6))  # about 1 / 1.6 of the ground is in the picture
    seconds = 1 / scene.frame_rate
    forget = min(1.0, scene.turning * seconds)
    place, heading = _anywhere(n, rng), rng.uniform(0, 2 * np.pi, n)
    typical = scene.speed * scene.stature * rng.lognormal(0, 0.5, n)
    velocity = typical[:, None] * np.stack([np.cos(heading), np.sin(heading)], 1)
    identity = np.arange(1, n + 1)
    phase, pace = rng.uniform(0, 2 * np.pi, (2, n, 2)), rng.uniform(0.4, 1.5, (n, 2))
    paths, names, seen = [], [], n
    for t in range(scene.frames):
        sway = scene.swaying * scene.stature * np.sin(phase[0] + 2 * np.pi * pace * t * seconds)
        paths.append(place + sway)
        names.append(identity.copy())
        kick = rng.normal(size=(n, 2)) * typical[:, None] / np.sqrt(2)
        velocity += -forget * velocity + np.sqrt(2 * forget) * kick
        place = place + velocity * seconds
        place[:, 1] -= scene.drive * seconds
        out = (place[:, 1] < NEAR) | (place[:, 1] > FAR) | (np.abs(place[:, 0]) > 1.3 * place[:, 1])
        place[out] = _anywhere(int(out.sum()), rng, scene.drive > 0)
        identity[out] = seen + 1 + np.arange(out.sum())
        seen += int(out.sum())
    return np.stack(paths), np.stack(names)


def _anywhere(n: int, rng: np.random.Generator, far: bool = False) -> Float64[np.ndarray, "n 2"]:
    """Places on the ground, far away where the camera drives towards them."""
    depth = rng.uniform(0.6 * FAR, FAR, n) if far else np.sqrt(rng.uniform(NEAR**2, FAR**2, n))
    return np.stack([rng.uniform(-1, 1, n) * depth, depth], 1)


def _seen(
    scene: Scene, place: np.ndarray, identity: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Boxes x1 y1 x2 y2 of the resting camera, depths, frames from 0 and identities, row by row."""
    frames, n = identity.shape
    frame = np.repeat(np.arange(frames), n)
    side, depth = place.reshape(-1, 2).T
    who = identity.reshape(-1)
    draw = np.random.default_rng([seed, 3]).normal(size=(int(who.max()) + 1, 2))
    height = scene.stature * np.exp(0.08 * draw[who, 0]) * FOCAL / depth
    width = scene.breadth * np.exp(0.12 * draw[who, 1]) * height
    foot = HEIGHT * 0.35 + 2.2 * scene.stature * FOCAL / depth
    middle = WIDTH / 2 + side * FOCAL / depth
    box = np.stack([middle - width / 2, foot - height, middle + width / 2, foot], 1)
    return box, depth, frame, who


def _inside(box: np.ndarray) -> np.ndarray:
    """Which boxes have their middle in the picture."""
    x, y = (box[:, 0] + box[:, 2]) / 2, (box[:, 1] + box[:, 3]) / 2
    return (x > 0) & (x < WIDTH) & (y > 0) & (y < HEIGHT)


def _visible(box: np.ndarray, depth: np.ndarray, frame: np.ndarray, frames: int) -> np.ndarray:
    """The share of each box that nearer ones leave free."""
    cuts = np.searchsorted(frame, np.arange(1, frames))
    parts = zip(np.split(box, cuts), np.split(depth, cuts), strict=True)
    return np.concatenate([visible_share(b, d) for b, d in parts])


def _alike(noise: np.ndarray, identity: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Noise of variance 1 that is correlated along each identity, frame after frame."""
    order = np.lexsort((frame, identity))
    out = noise[order]
    new = np.diff(identity[order], prepend=-1) != 0
    for i in np.flatnonzero(~new):
        out[i] = CORRELATION * out[i - 1] + np.sqrt(1 - CORRELATION**2) * out[i]
    back = np.empty_like(out)
    back[order] = out
    return back


def _observations(
    scene: Scene, frame: np.ndarray, box: np.ndarray, score: np.ndarray, identity: np.ndarray
) -> Observations:
    number = torch.from_numpy(frame.astype(np.int64) + 1)
    features = {
        "frame": number,
        "time": (number - 1).double() / scene.frame_rate,
        "camera": torch.zeros_like(number),
        "box": torch.from_numpy(box.astype(np.float32)),
        "confidence": torch.from_numpy(score.astype(np.float32)),
        "identity": torch.from_numpy(identity.astype(np.int64)),
    }
    return Observations(number, features)
