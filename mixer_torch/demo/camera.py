"""The camera of the parking lot: where it is driven, what its lens and sensor make of the light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from mixer_torch.demo.rendering import Camera, shade
from mixer_torch.demo.scene import AISLE, Layout, Scene

FIELD_OF_VIEW = math.radians(69)
CAMERA_HEIGHT = 0.95  # metres
CORNER = 5.0  # radius of the path at the ends of the rows, metres
SUPERSAMPLING = 1.3
JPEG_QUALITY = 93


def drive(layout: Layout, distances: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Poses (n, 3) of x, y and heading after distances along the loop around the inner rows.

    The loop is a rectangle with round corners, driven counter-clockwise; the driver weaves a
    little, and differently on each lap.
    """
    sway = 0.6 * _waves(distances, (11.0, 27.0), generator)
    x, y, heading = _loop(layout, 0.3 * layout.length + distances)
    x, y = x - sway * np.sin(heading), y + sway * np.cos(heading)
    return np.stack(
        [x, y, heading + math.radians(3) * _waves(distances, (9.0, 19.0), generator)], 1
    )


def _sides(layout: Layout) -> list[float]:
    """Lengths of straight and corner, by turns, of one lap."""
    wide, deep = layout.length + AISLE - 2 * CORNER, 2 * layout.aisle - 2 * CORNER
    return [wide, math.pi / 2 * CORNER, deep, math.pi / 2 * CORNER] * 2


def loop_length(layout: Layout) -> float:
    """Metres of one lap."""
    return sum(_sides(layout))


def _loop(layout: Layout, distances: np.ndarray) -> np.ndarray:
    """(3, n) x, y and heading, by integrating the heading in small steps of one lap."""
    sides = _sides(layout)
    steps = np.linspace(0, sum(sides), 10_000)
    heading = np.interp(
        steps, np.cumsum([0, *sides]), np.repeat(np.arange(5), 2)[:-1] * math.pi / 2
    )
    x = cumulative_trapezoid(np.cos(heading), steps, initial=0) - sides[0] / 2
    y = cumulative_trapezoid(np.sin(heading), steps, initial=0) - sides[2] / 2 - CORNER
    rest = distances % steps[-1]
    return np.stack([np.interp(rest, steps, values) for values in (x, y, heading)])


def _waves(
    distances: np.ndarray, lengths: tuple[float, ...], generator: np.random.Generator
) -> np.ndarray:
    """A smooth wander of about unit size: sines of some wave lengths and random phases."""
    phase = generator.uniform(0, 2 * np.pi, len(lengths))
    waves = np.sin(2 * np.pi * distances[:, None] / np.array(lengths) + phase)
    return waves.mean(1) * math.sqrt(2)


def odometry_error(poses: np.ndarray, drift: float, generator: np.random.Generator) -> np.ndarray:
    """How the odometry goes wrong along a path of (n, 3) true poses x, y and heading.

    Every step is turned by an error of the heading that grows at a steady rate and by a random
    walk, and is too long or too short by a constant factor.

    Args:
        poses: True.
        drift: Degrees a metre.
        generator: Draws.

    Returns:
        (n, 3) an angle (radians) and a shift along x and y, such that a world point p is believed
        at rotation(angle) p + shift.
    """
    steps = np.diff(poses[:, :2], axis=0)
    length = np.linalg.norm(steps, axis=1)
    rate = math.radians(drift) * generator.choice([-1, 1]) * generator.uniform(0.9, 1.3)
    walk = generator.normal(0, 1, len(steps)) * math.radians(1.5 * drift) * np.sqrt(length)
    angle = np.concatenate([[0.0], np.cumsum(rate * length + walk)])
    scale = 1 + 0.1 * drift * generator.normal()
    turned = scale * rotate(angle[:-1] + np.diff(angle) / 2, steps)
    believed = poses[0, :2] + np.concatenate([np.zeros((1, 2)), np.cumsum(turned, axis=0)])
    return np.column_stack([angle, believed - rotate(angle, poses[:, :2])])


def rotate(angle: Any, points: np.ndarray) -> np.ndarray:
    """Points (n, 2) turned about the origin by an angle or by (n,) angles."""
    c, s, (x, y) = np.cos(angle), np.sin(angle), points.T
    return np.stack([c * x - s * y, s * x + c * y], axis=1)


def mount(
    poses: np.ndarray, distances: np.ndarray, size: tuple[int, int], generator: np.random.Generator
) -> list[Camera]:
    """The camera on the vehicle at each pose: it pans slowly and shakes a little.

    Args:
        poses: (n, 3) x, y and heading.
        distances: (n,) travelled.
        size: Width and height in pixels.
        generator: Draws.
    """
    pan = poses[:, 2] + math.radians(15) + math.radians(8) * _waves(distances, (31.0,), generator)
    shake = generator.normal([math.radians(-1.0), 0], math.radians(0.5), (len(poses), 2))
    focal = size[0] / 2 / math.tan(FIELD_OF_VIEW / 2)
    cameras = []
    for (x, y, _), yaw, (pitch, roll) in zip(poses, pan, shake, strict=True):
        level = math.cos(pitch)
        forward = np.array([level * math.cos(yaw), level * math.sin(yaw), math.sin(pitch)])
        right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
        down = np.cross(forward, right)
        c, s = math.cos(roll), math.sin(roll)
        axes = np.stack([c * right + s * down, c * down - s * right, forward])
        cameras.append(Camera(*size, focal, np.array([x, y, CAMERA_HEIGHT]), axes))
    return cameras


class ParkingLotFrames(Sequence[np.ndarray]):
    """The frames, each rendered when it is first asked for and then held as a JPEG.

    Args:
        scene: What there is to see.
        cameras: One for each frame.
        harshness: Of the light, as the sensor suffers from it.
        seed: Of the sensor's noise and of its exposure.
    """

    def __init__(
        self, scene: Scene, cameras: Sequence[Camera], harshness: float, seed: int
    ) -> None:
        self._scene, self._cameras = scene, list(cameras)
        self._harshness, self._seed = harshness, seed
        # The exposure wanders by about 0.3 stops, as a first-order random walk.
        walk = np.random.default_rng([seed, 5]).normal(0, 0.3, len(self._cameras))
        self._stops = lfilter([0.6], [1, -0.8], walk)
        self._encoded: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        return len(self._cameras)

    def __getitem__(self, index: Any) -> Any:
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of a sequence of {len(self)}")
        index = int(index) % len(self)
        if index not in self._encoded:
            quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
            image = self._render(index)
            self._encoded[index] = cv2.imencode(".jpg", image[..., ::-1], quality)[1]
        decoded: Any = cv2.imdecode(self._encoded[index], cv2.IMREAD_COLOR)
        return cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB)

    def _render(self, index: int) -> np.ndarray:
        camera = self._cameras[index]
        scene = self._scene
        light = shade(
            camera.scaled(SUPERSAMPLING), scene.mesh, scene.atlas, scene.light, scene.grain
        )
        light = cv2.resize(light, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        generator = np.random.default_rng([self._seed, 6, index])
        return develop(light, 2.0 ** self._stops[index], self._harshness, generator)


def develop(
    light: Float[np.ndarray, "height width 3"],
    exposure: float,
    harshness: float,
    generator: np.random.Generator,
) -> UInt8[np.ndarray, "height width 3"]:
    """Linear light to an 8-bit photograph.

    Glare in the lens, vignetting, automatic exposure that meters the whole frame (so cars before
    a bright sky come out dark and those beside a dark one white), the colours of a small sensor,
    a steep tone curve that clips, noise and a slight blur.

    Args:
        light: Linear RGB.
        exposure: Factor by which the metering is off.
        harshness: 1 for a clear day; more widens what is lost in shadows and highlights.
        generator: Of the noise.
    """
    height, width = light.shape[:2]
    small = cv2.resize(
        np.minimum(light, 12.0), (width // 8, height // 8), interpolation=cv2.INTER_AREA
    )
    glare = cv2.GaussianBlur(np.maximum(small - 0.9, 0), (0, 0), width / 60)
    light = light + 0.13 * harshness * cv2.resize(glare, (width, height))
    metered = float(np.exp(np.log(small.mean(axis=2) + 0.02).mean()))
    x, y = (np.linspace(-side, side, side, dtype=np.float32) / width for side in (width, height))
    vignette = 1 - 0.22 * (x**2 + y[:, None] ** 2)
    saturation = 0.85 - 0.15 * min(harshness, 2.0)
    mix = saturation * np.eye(3) + (1 - saturation) / 3
    mix *= 0.30 * exposure / metered
    image = cv2.transform(light * vignette[..., None], mix.astype(np.float32))
    image = cv2.GaussianBlur(np.clip(image, 0, 1.5), (0, 0), 0.55)
    # Shot and read noise: stronger, but less than in proportion, where it is bright.
    noise = generator.standard_normal((height, width, 1), dtype=np.float32)
    image += noise * (0.004 + 0.008 * cv2.sqrt(image))
    image = np.clip(image * (1.0 + 0.20 * harshness) - 0.012 * harshness, 0, 1)
    return (255 * cv2.pow(image, 1 / 2.2) + 0.5).astype(np.uint8)
