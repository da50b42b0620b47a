"""The camera of the parking lot: where it is driven, what its lens and sensor make of the light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from mixer_torch.demo.rendering import Camera, shade
from mixer_torch.demo.scene import AISLE, Layout, Scene

FIELD_OF_VIEW = math.radians(69)
CAMERA_HEIGHT = 0.95  # metres
CORNER = 5.0  # radius of the path at the ends of the rows, metres
SUPERSAMPLING = 1.3
JPEG_QUALITY = 93
CODES = 4096  # steps of the sensor before the tone curve


def drive(layout: Layout, distances: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Poses (n, 3) of x, y and heading after distances along the loop around the inner rows.

    The loop is a rectangle with round corners, driven counter-clockwise; the driver weaves a
    little, and differently on each lap.
    """
    start = 0.3 * layout.length
    sway = _waves(distances, (11.0, 27.0), generator)
    path = np.array([_loop(layout, start + s) for s in distances]).reshape(-1, 3)
    sideways = 0.6 * sway[:, None] * np.stack([-np.sin(path[:, 2]), np.cos(path[:, 2])], axis=1)
    heading = path[:, 2] + math.radians(3) * _waves(distances, (9.0, 19.0), generator)
    return np.concatenate([path[:, :2] + sideways, heading[:, None]], axis=1)


def loop_length(layout: Layout) -> float:
    """Metres of one lap."""
    wide, deep = _sides(layout)
    return 2 * wide + 2 * deep + 2 * math.pi * CORNER


def _sides(layout: Layout) -> tuple[float, float]:
    """Lengths of the straights along x and y."""
    return layout.length + AISLE - 2 * CORNER, 2 * layout.aisle - 2 * CORNER


def _loop(layout: Layout, distance: float) -> tuple[float, float, float]:
    wide, deep = _sides(layout)
    turn = math.pi / 2 * CORNER
    rest = distance % loop_length(layout)
    x, y, heading = -wide / 2, -deep / 2 - CORNER, 0.0
    for straight in (wide, deep, wide, deep):
        along = min(rest, straight)
        x, y = x + along * math.cos(heading), y + along * math.sin(heading)
        rest -= along
        angle = min(rest, turn) / CORNER
        ahead, left = CORNER * math.sin(angle), CORNER * (1 - math.cos(angle))
        x, y = (
            x + ahead * math.cos(heading) - left * math.sin(heading),
            y + ahead * math.sin(heading) + left * math.cos(heading),
        )
        heading += angle
        rest -= min(rest, turn)
        if rest <= 0:
            break
    return x, y, heading


def _waves(
    distances: np.ndarray, lengths: tuple[float, ...], generator: np.random.Generator
) -> np.ndarray:
    """A smooth wander of about unit size: sines of some wave lengths and random phases."""
    phase = generator.uniform(0, 2 * np.pi, len(lengths))
    waves = np.sin(2 * np.pi * distances[:, None] / np.array(lengths) + phase)
    return waves.mean(1) * math.sqrt(2)


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
    shake = generator.normal(0, math.radians(0.5), (len(poses), 2))
    focal = size[0] / 2 / math.tan(FIELD_OF_VIEW / 2)
    cameras = []
    for (x, y, _), yaw, (pitch, roll) in zip(poses, pan, shake, strict=True):
        pitch = pitch - math.radians(1.0)
        level = math.cos(pitch)
        forward = np.array([level * math.cos(yaw), level * math.sin(yaw), math.sin(pitch)])
        right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
        down = np.cross(forward, right)
        turned = np.stack(
            [
                math.cos(roll) * right + math.sin(roll) * down,
                math.cos(roll) * down - math.sin(roll) * right,
                forward,
            ]
        )
        cameras.append(Camera(*size, focal, np.array([x, y, CAMERA_HEIGHT]), turned))
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
        generator = np.random.default_rng([seed, 5])
        self._stops = _drifting(generator, len(self._cameras), 0.30)
        self._tint = np.stack([_drifting(generator, len(self._cameras), 0.05) for _ in "rb"], 1)
        self._encoded: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        return len(self._cameras)

    def __getitem__(self, index: Any) -> Any:
        import cv2

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
        import cv2

        scene, camera = self._scene, self._cameras[index]
        fine = camera.scaled(SUPERSAMPLING)
        light = shade(fine, scene.mesh, scene.atlas, scene.ground, scene.light)
        light = cv2.resize(light, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        return develop(
            light,
            2.0 ** self._stops[index],
            np.exp([self._tint[index, 0], 0.0, self._tint[index, 1]]),
            self._harshness,
            np.random.default_rng([self._seed, 6, index]),
        )


def develop(
    light: Float[np.ndarray, "height width 3"],
    exposure: float,
    tint: Any,
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
        tint: (3,) factors by which the white balance is off.
        harshness: 1 for a clear day; more widens what is lost in shadows and highlights.
        generator: Of the noise.
    """
    import cv2

    height, width = light.shape[:2]
    small = cv2.resize(
        np.minimum(light, 12.0), (width // 8, height // 8), interpolation=cv2.INTER_AREA
    )
    glare = cv2.GaussianBlur(np.maximum(small - 0.9, 0), (0, 0), width / 90)
    glare += 0.5 * cv2.GaussianBlur(np.maximum(small - 0.9, 0), (0, 0), width / 30)
    light = light + 0.10 * harshness * cv2.resize(glare, (width, height))
    metered = float(np.exp(np.log(small.mean(axis=2) + 0.02).mean()))
    column = (np.arange(width, dtype=np.float32) - width / 2) ** 2 / (width / 2) ** 2
    row = (np.arange(height, dtype=np.float32)[:, None] - height / 2) ** 2 / (width / 2) ** 2
    vignette = 1 - 0.22 * (column + row)
    saturation = 0.85 - 0.15 * min(harshness, 2.0)
    mix = saturation * np.eye(3) + (1 - saturation) / 3
    mix = mix @ np.diag(np.asarray(tint) * 0.30 * exposure / metered)
    image = cv2.transform(light * vignette[..., None], mix.astype(np.float32))
    image = cv2.GaussianBlur(np.clip(image, 0, 1.5), (0, 0), 0.55)
    image += _noise(image, generator)
    image = image * (1.0 + 0.20 * harshness) - 0.012 * harshness
    curve = 255 * np.linspace(0, 1, CODES) ** (1 / 2.2) + 0.5
    codes = (np.clip(image, 0, 1) * (CODES - 1)).astype(np.uint16)
    return curve.astype(np.uint8)[codes]


def _noise(image: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Shot and read noise: stronger, but less than in proportion, where it is bright."""
    import cv2

    noise = generator.standard_normal((128, 128, 3), dtype=np.float32)
    tiles = [-(-side // 128) + 1 for side in image.shape[:2]]
    row, column = generator.integers(0, 128, 2)
    noise = np.tile(noise, (*tiles, 1))[row:, column:][: image.shape[0], : image.shape[1]]
    return cv2.multiply(np.ascontiguousarray(noise), 0.006 + 0.012 * cv2.sqrt(image))


def _drifting(generator: np.random.Generator, count: int, size: float) -> np.ndarray:
    """A stationary first-order random walk with a standard deviation."""
    value, values = generator.normal(0, size), []
    for step in generator.normal(0, size, count):
        values.append(value)
        value = 0.8 * value + 0.6 * step
    return np.array(values)
