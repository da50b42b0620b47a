"""A rendered parking lot: the scene that ships with the library, made from a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from mixer_torch.datasets.base import Dataset
from mixer_torch.extras import require
from mixer_torch.observations import Images, Observations

if TYPE_CHECKING:
    from mixer_torch.demo.camera import ParkingLotFrames
    from mixer_torch.demo.rendering import Camera
    from mixer_torch.demo.scene import Scene

MIN_POINTS = 5  # of the range sensor; fewer are no position
LEAST = {"seed": 0, "num_cars": 1, "num_frames": 1, "width": 64, "height": 64}
MOST = {
    "odometry_drift": 10.0,
    "box_jitter": 1.0,
    "miss_rate": 1.0,
    "range_noise": 10.0,
    "range_dropout": 1.0,
    "light_harshness": 5.0,
}


@dataclass(eq=False)
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

    seed: int = 0
    num_cars: int = 29
    num_frames: int = 100
    width: int = 640
    height: int = 480
    frame_rate: float = 2.0
    speed: float = 1.55
    odometry_drift: float = 0.25
    box_jitter: float = 0.025
    miss_rate: float = 0.06
    range_noise: float = 0.1
    range_dropout: float = 0.3
    light_harshness: float = 1.0

    def __post_init__(self) -> None:
        for name, least in LEAST.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ValueError(f"{name}: expected an integer of {least} or more, got {value!r}")
        for name in ("frame_rate", "speed"):
            if not 0 < (value := getattr(self, name)) < math.inf:
                raise ValueError(f"{name}: expected a finite number above 0, got {value}")
        for name, most in MOST.items():
            if not 0 <= (value := getattr(self, name)) <= most:
                raise ValueError(f"{name}: expected a number from 0 to {most:g}, got {value}")

    def load(self) -> Observations:
        world = self.world()
        from mixer_torch.demo.camera import rotate
        from mixer_torch.demo.detector import look

        generator = np.random.default_rng([self.seed, 3])
        rows = []
        for frame, (camera, error) in enumerate(zip(world.cameras, world.drift, strict=True)):
            sight = look(world.scene, camera)
            for car in generator.permutation(sight.detected(self.miss_rate, generator)).tolist():
                box = sight.box(car, self.box_jitter, generator)
                points = sight.range_points(box, self.range_noise, self.range_dropout, generator)
                points[:, :2] = rotate(error[0], points[:, :2]) + error[1:]
                known = len(points) >= MIN_POINTS
                position = np.median(points, axis=0) if known else np.full(3, np.nan)
                row = (frame, box, position, sight.confidence(car, generator), car)
                rows.append(row)
        return self._observations(rows, world.frames)

    def world(self) -> World:
        """The scene, the cameras in it and the odometry's error, without any detection."""
        require("cv2", extra="vision")  # before the renderer's own imports of it
        from mixer_torch.demo.camera import ParkingLotFrames, drive, mount, odometry_error
        from mixer_torch.demo.scene import build_scene, layout_for

        scene = build_scene(self.num_cars, self.light_harshness, self.seed)
        generator = np.random.default_rng([self.seed, 2])
        distances = np.arange(self.num_frames) * self.speed / self.frame_rate
        poses = drive(layout_for(self.num_cars), distances, generator)
        cameras = mount(poses, distances, (self.width, self.height), generator)
        drift = odometry_error(poses, self.odometry_drift, np.random.default_rng([self.seed, 4]))
        frames = ParkingLotFrames(scene, cameras, self.light_harshness, self.seed)
        return World(scene, cameras, drift, frames)

    def _observations(self, rows: list, frames: ParkingLotFrames) -> Observations:
        m = len(rows)
        columns = list(zip(*rows, strict=True)) if rows else [()] * 5
        frame = torch.tensor(columns[0], dtype=torch.int64)
        box = np.array(columns[1], np.float32).reshape(m, 4)
        features = {
            "time": frame.double() / self.frame_rate,
            "frame": frame,
            "camera": torch.zeros(m, dtype=torch.int64),
            "box": torch.from_numpy(box),
            "position": torch.from_numpy(np.array(columns[2], np.float32).reshape(m, 3)),
            "confidence": torch.tensor(columns[3], dtype=torch.float32),
            "identity": torch.tensor(columns[4], dtype=torch.int64),
        }
        return Observations(frame, features, Images(frames, frame.numpy(), box))


@dataclass(frozen=True)
class World:
    """What is true of a lot.

    Args:
        scene: Cars and everything else that stands still.
        cameras: One for each frame, at its true pose.
        drift: (n, 3) the odometry's error at each frame, as `odometry_error` returns it.
        frames: The pictures.
    """

    scene: Scene
    cameras: list[Camera]
    drift: np.ndarray
    frames: ParkingLotFrames
