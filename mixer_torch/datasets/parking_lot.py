"""A rendered parking lot: the scene that ships with the library, made from a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from mixer_torch.datasets.base import Dataset
from mixer_torch.observations import Images, Observations

if TYPE_CHECKING:
    from mixer_torch.demo.camera import ParkingLotFrames
    from mixer_torch.demo.rendering import Camera
    from mixer_torch.demo.scene import Scene

SUN_HEIGHT = math.radians(36)
COARSE = 0.5  # pixels of the depth image that detections are made from, per pixel of the frame
MIN_HEIGHT = 0.056  # of a detected box, as a share of the image's
MIN_VISIBLE = 0.2  # share of a car's silhouette that others leave visible
MIN_INSIDE = 0.2  # share of a car's box that is inside the image
MIN_POINTS = 5
MAX_RANGE = 60.0  # metres
SCAN = (5, 2)  # rows and columns of the depth image between two beams of the range sensor


class ParkingLot(Dataset):
    """Parked cars seen from a small vehicle that drives around them, with everything known.

    A stand-in for the data set of section IV of the paper: a lot with four rows of bays around a
    loop of aisles, a pin-hole camera driven along the loop (about 1.3 laps by default, so that
    cars are seen again after a long gap), hard sunlight that leaves little of the colours. Some
    cars are twins: same model and colour. Everything is drawn from the seed; frames are rendered
    when they are first asked for.

    Each frame is one view. Features: ``time``, from 0; ``frame``; ``camera``, 0; ``box``, of what
    is visible of a car or of what a detector would guess of it; ``position``, the median of noisy
    range points inside the box, some of which lie on the background or on a neighbour, in the
    frame of drifting odometry that starts at the truth, NaN where there are too few points;
    ``confidence``; ``identity``, from 0 to num_cars - 1.

    Args:
        seed: Of every draw; another seed is another lot.
        num_cars: Parked cars; the lot grows with them.
        num_frames: Frames, at a constant speed and frame rate.
        width: Of a frame, pixels.
        height: Of a frame, pixels.
        frame_rate: Frames a second.
        speed: Of the vehicle, metres a second.
        odometry_drift: Degrees of heading that the odometry loses a metre, on average and always to
            the same side; a random walk of the heading and an error of scale grow with it.
        box_jitter: Standard deviation of a box's edges, as a share of its size.
        miss_rate: Probability that a car in plain view is not detected; hidden and small ones are
            missed more often.
        range_noise: Standard deviation of the range points along their rays, metres.
        range_dropout: Share of the range points that are lost.
        light_harshness: Strength of the sun and of what it does to the picture; 1 is a clear day.

    Raises:
        ValueError: An argument is out of its range.
    """

    def __init__(
        self,
        seed: int = 0,
        num_cars: int = 29,
        num_frames: int = 100,
        width: int = 640,
        height: int = 480,
        frame_rate: float = 2.0,
        speed: float = 1.55,
        odometry_drift: float = 0.25,
        box_jitter: float = 0.025,
        miss_rate: float = 0.06,
        range_noise: float = 0.1,
        range_dropout: float = 0.3,
        light_harshness: float = 1.0,
    ) -> None:
        for name, value, least in (
            ("seed", seed, 0),
            ("num_cars", num_cars, 1),
            ("num_frames", num_frames, 1),
            ("width", width, 64),
            ("height", height, 64),
        ):
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ValueError(f"{name}: expected an integer of {least} or more, got {value!r}")
        for name, number in (("frame_rate", frame_rate), ("speed", speed)):
            if not (math.isfinite(number) and number > 0):
                raise ValueError(f"{name}: expected a finite number above 0, got {number}")
        for name, number, most in (
            ("odometry_drift", odometry_drift, 10.0),
            ("box_jitter", box_jitter, 1.0),
            ("miss_rate", miss_rate, 1.0),
            ("range_noise", range_noise, 10.0),
            ("range_dropout", range_dropout, 1.0),
            ("light_harshness", light_harshness, 5.0),
        ):
            if not 0 <= number <= most:
                raise ValueError(f"{name}: expected a number from 0 to {most:g}, got {number}")
        self.seed, self.num_cars, self.num_frames = seed, num_cars, num_frames
        self.width, self.height = width, height
        self.frame_rate, self.speed = frame_rate, speed
        self.odometry_drift, self.box_jitter, self.miss_rate = odometry_drift, box_jitter, miss_rate
        self.range_noise, self.range_dropout = range_noise, range_dropout
        self.light_harshness = light_harshness

    def load(self) -> Observations:
        world = self.world()
        generator = np.random.default_rng([self.seed, 3])
        rows: dict[str, list] = {
            "frame": [],
            "box": [],
            "position": [],
            "confidence": [],
            "identity": [],
        }
        for frame, (camera, correction) in enumerate(zip(world.cameras, world.drift, strict=True)):
            sight = look(world.scene, camera)
            found = self._detect(sight, generator)
            for car in generator.permutation(found).tolist():
                box = self._box(sight, car, generator)
                points = self._range(sight, box, generator)
                rows["frame"].append(frame)
                rows["box"].append(box)
                rows["position"].append(_median(_apply(correction, points)))
                rows["confidence"].append(sight.confidence(car, generator))
                rows["identity"].append(car)
        return self._observations(rows, world.frames)

    def world(self) -> World:
        """The scene, the cameras in it and the odometry's error, without any detection."""
        from mixer_torch.demo.camera import ParkingLotFrames, drive, mount
        from mixer_torch.demo.scene import build_scene, layout_for

        scene = build_scene(self.num_cars, SUN_HEIGHT, self.light_harshness, self.seed)
        generator = np.random.default_rng([self.seed, 2])
        distances = np.arange(self.num_frames) * self.speed / self.frame_rate
        poses = drive(layout_for(self.num_cars), distances, generator)
        cameras = mount(poses, distances, (self.width, self.height), generator)
        drift = odometry_error(poses, self.odometry_drift, np.random.default_rng([self.seed, 4]))
        frames = ParkingLotFrames(scene, cameras, self.light_harshness, self.seed)
        return World(scene, cameras, drift, frames)

    def _detect(self, sight: Sight, generator: np.random.Generator) -> np.ndarray:
        """Cars that the detector reports."""
        height = sight.inside[:, 3] - sight.inside[:, 1]
        least = MIN_HEIGHT * self.height
        share = _area(sight.inside) / np.maximum(_area(sight.whole), 1e-9)
        good = (sight.visible >= MIN_VISIBLE) & (height >= least) & (share >= MIN_INSIDE)
        hard = 0.4 * (1 - sight.visible) + 0.3 * np.clip(2 - height / least, 0, 1)
        chance = (1 - self.miss_rate) * (1 - np.minimum(1, hard) * min(1.0, 8 * self.miss_rate))
        return np.flatnonzero(good & (generator.random(len(good)) < chance))

    def _box(self, sight: Sight, car: int, generator: np.random.Generator) -> np.ndarray:
        """A jittered box: of the visible part, of the whole, or between the two."""
        guess = 1.0 if sight.visible[car] > 0.8 else 0.6 * generator.random()
        box = guess * sight.inside[car] + (1 - guess) * sight.seen[car]
        size = np.tile(box[2:] - box[:2], 2)
        box = box + generator.normal(0, self.box_jitter, 4) * size
        limit = np.array([self.width, self.height, self.width, self.height], float)
        box = np.clip(box, 0, limit)
        middle = np.clip((box[:2] + box[2:]) / 2, 2, limit[:2] - 2)
        return np.concatenate([np.minimum(box[:2], middle - 2), np.maximum(box[2:], middle + 2)])

    def _range(self, sight: Sight, box: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """(p, 3) points of the range sensor that fall inside a box, world coordinates."""
        rows, columns = sight.depth.shape
        first = generator.integers(SCAN)
        i, j = np.mgrid[first[0] : rows : SCAN[0], first[1] : columns : SCAN[1]].reshape(2, -1)
        x, y = (j + 0.5) / COARSE, (i + 0.5) / COARSE
        inside = (x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])
        kept = inside & (generator.random(len(i)) >= self.range_dropout)
        i, j = i[kept], j[kept]
        points = sight.points(i, j, generator.normal(0, self.range_noise, len(i)))
        return points[np.isfinite(points).all(1)]

    def _observations(self, rows: dict[str, list], frames: ParkingLotFrames) -> Observations:
        frame = torch.tensor(rows["frame"], dtype=torch.int64)
        m = len(frame)
        box = np.array(rows["box"], np.float32).reshape(m, 4)
        features = {
            "time": frame.double() / self.frame_rate,
            "frame": frame,
            "camera": torch.zeros(m, dtype=torch.int64),
            "box": torch.from_numpy(box),
            "position": torch.from_numpy(np.array(rows["position"], np.float32).reshape(m, 3)),
            "confidence": torch.tensor(rows["confidence"], dtype=torch.float32),
            "identity": torch.tensor(rows["identity"], dtype=torch.int64),
        }
        return Observations(frame, features, Images(frames, frame.numpy(), box))


@dataclass(frozen=True)
class World:
    """What is true of a lot.

    Args:
        scene: Cars and everything else that stands still.
        cameras: One for each frame, at its true pose.
        drift: (n, 4) the odometry's error at each frame: the rotation about the vertical (radians)
            and where it takes the camera, x and y of the true place and of the believed one less
            the true one, as :func:`odometry_error` returns it.
        frames: The pictures.
    """

    scene: Scene
    cameras: list[Camera]
    drift: np.ndarray
    frames: ParkingLotFrames


@dataclass(frozen=True)
class Sight:
    """What is visible of each car in a frame, before any noise. Boxes in pixels of the frame.

    Args:
        camera: At its true pose.
        depth: Depth image, COARSE pixels a pixel, infinite where there is sky.
        whole: (n, 4) boxes of the silhouettes, beyond the image and through other cars.
        inside: (n, 4) the part of them inside the image.
        seen: (n, 4) boxes of the visible pixels.
        visible: (n,) visible share of the silhouette inside the image; 0 if a car is not in view.
    """

    camera: Camera
    depth: np.ndarray
    whole: np.ndarray
    inside: np.ndarray
    seen: np.ndarray
    visible: np.ndarray

    def points(self, row: np.ndarray, column: np.ndarray, error: np.ndarray) -> np.ndarray:
        """(p, 3) world points of pixels of the depth image, moved by an error along their rays."""
        camera = self.camera.scaled(COARSE)
        x = (column + 0.5 - camera.width / 2) / camera.focal
        y = (row + 0.5 - camera.height / 2) / camera.focal
        ray = np.stack([x, y, np.ones_like(x)], axis=1)
        length = np.linalg.norm(ray, axis=1)
        depth = self.depth[row, column] + error / length
        depth = np.where(depth * length < MAX_RANGE, depth, np.nan)
        return camera.position + (depth[:, None] * ray) @ camera.rotation

    def confidence(self, car: int, generator: np.random.Generator) -> float:
        """Lower for what is hidden or small."""
        small = 25.0 / max(self.inside[car, 3] - self.inside[car, 1], 1.0)
        value = 1.0 - 0.4 * (1 - self.visible[car]) - 0.3 * small + generator.normal(0, 0.05)
        return float(np.clip(value, 0.05, 0.99))


def look(scene: Scene, camera: Camera) -> Sight:
    """Find the silhouettes of all cars in a frame."""
    from mixer_torch.demo.rendering import coverage, rasterise

    count = len(scene.cars)
    coarse = camera.scaled(COARSE)
    screen = coarse.project(scene.mesh.vertices)
    nearest = np.zeros((coarse.height, coarse.width), np.float32)
    face = rasterise(screen, scene.mesh, scene.atlas, nearest)
    owner = np.where(face >= 0, scene.mesh.owner[face], -1)
    covered = coverage(screen, scene.mesh, nearest.shape, count)
    whole = np.zeros((count, 4))
    seen = np.zeros((count, 4))
    visible = np.zeros(count)
    for car in range(count):
        corners = screen[scene.mesh.faces[scene.mesh.owner == car].ravel()]
        rows, columns = np.nonzero(owner == car)
        if not len(rows) or (corners[:, 2] <= 0).any():
            continue
        whole[car] = [*corners[:, :2].min(0), *corners[:, :2].max(0)]
        seen[car] = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        visible[car] = len(rows) / max(covered[car], 1)
    whole, seen = whole / COARSE, seen / COARSE
    inside = np.clip(whole, 0, [camera.width, camera.height, camera.width, camera.height])
    return Sight(camera, _depth(coarse, nearest), whole, inside, seen, visible)


def _depth(camera: Camera, nearest: np.ndarray) -> np.ndarray:
    """Depth with the ground filled in where no triangle is."""
    x = (np.arange(camera.width) + 0.5 - camera.width / 2) / camera.focal
    y = (np.arange(camera.height)[:, None] + 0.5 - camera.height / 2) / camera.focal
    fall = -(x * camera.rotation[0, 2] + y * camera.rotation[1, 2] + camera.rotation[2, 2])
    with np.errstate(divide="ignore"):
        ground = np.where(fall > 0, camera.position[2] / fall, np.inf)
        return np.where(nearest > 0, 1 / nearest.astype(float), ground)


def odometry_error(poses: np.ndarray, drift: float, generator: np.random.Generator) -> np.ndarray:
    """The rigid motions (n, 4) that take the true world to the world as odometry believes it.

    Steps are measured in the vehicle's frame with a heading that is off by a constant rate and a
    random walk, and a scale that is a little off, and summed: the error is nothing at the first
    pose, small over a few frames and metres after a lap.

    Args:
        poses: (n, 3) true x, y and heading.
        drift: Degrees a metre.
        generator: Draws.

    Returns:
        A row of the angle (radians), then the shift along x and y, then 0 for z, such that a
        world point p is believed at rotation(angle) p + shift.
    """
    steps = np.diff(poses[:, :2], axis=0)
    length = np.linalg.norm(steps, axis=1)
    rate = math.radians(drift) * generator.choice([-1, 1]) * generator.uniform(0.9, 1.3)
    walk = generator.normal(0, 1, len(steps)) * math.radians(1.5 * drift) * np.sqrt(length)
    angle = np.concatenate([[0.0], np.cumsum(rate * length + walk)])
    scale = 1 + 0.1 * drift * generator.normal()
    turned = _rotation(angle[:-1] + np.diff(angle) / 2)
    believed = poses[0, :2] + np.concatenate(
        [np.zeros((1, 2)), np.cumsum(scale * np.einsum("nij,nj->ni", turned, steps), axis=0)]
    )
    shift = believed - np.einsum("nij,nj->ni", _rotation(angle), poses[:, :2])
    return np.stack([angle, shift[:, 0], shift[:, 1], np.zeros(len(angle))], axis=1)


def _rotation(angle: Any) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def _apply(motion: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (p, 3) moved by a row of :func:`odometry_error`."""
    turned = points[:, :2] @ _rotation(motion[0]).T
    return np.concatenate([turned, points[:, 2:]], axis=1) + motion[1:]


def _median(points: np.ndarray) -> np.ndarray:
    return np.median(points, axis=0) if len(points) >= MIN_POINTS else np.full(3, np.nan)


def _area(box: Any) -> Any:
    return (box[:, 2] - box[:, 0]) * (box[:, 3] - box[:, 1])
