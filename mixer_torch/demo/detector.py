"""What a detector and a range sensor on the vehicle make of the parked cars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixer_torch.demo.rendering import Camera, rasterise
from mixer_torch.demo.scene import Scene

COARSE = 0.5  # pixels of the depth image that detections are made from, per pixel of the frame
MIN_HEIGHT = 0.056  # of a detected box, as a share of the image's
MIN_VISIBLE = 0.2  # share of a car's silhouette that others leave visible
MIN_INSIDE = 0.2  # share of a car's box that is inside the image
MAX_RANGE = 60.0  # metres
SCAN = (5, 2)  # rows and columns of the depth image between two beams of the range sensor


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

    def detected(self, miss_rate: float, generator: np.random.Generator) -> np.ndarray:
        """Cars that the detector reports; hidden and small ones are missed more often."""
        height, least = self.inside[:, 3] - self.inside[:, 1], MIN_HEIGHT * self.camera.height
        share = _area(self.inside) / np.maximum(_area(self.whole), 1e-9)
        good = (self.visible >= MIN_VISIBLE) & (height >= least) & (share >= MIN_INSIDE)
        hard = 0.4 * (1 - self.visible) + 0.3 * np.clip(2 - height / least, 0, 1)
        chance = (1 - miss_rate) * (1 - np.minimum(1, hard) * min(1.0, 8 * miss_rate))
        return np.flatnonzero(good & (generator.random(len(good)) < chance))

    def confidence(self, car: int, generator: np.random.Generator) -> float:
        """Lower for what is hidden or small."""
        small = 25.0 / max(self.inside[car, 3] - self.inside[car, 1], 1.0)
        value = 1.0 - 0.4 * (1 - self.visible[car]) - 0.3 * small + generator.normal(0, 0.05)
        return float(np.clip(value, 0.05, 0.99))

    def box(self, car: int, jitter: float, generator: np.random.Generator) -> np.ndarray:
        """A jittered box: of the visible part, of the whole, or between the two."""
        guess = 1.0 if self.visible[car] > 0.8 else 0.6 * generator.random()
        box = guess * self.inside[car] + (1 - guess) * self.seen[car]
        box = box + generator.normal(0, jitter, 4) * np.tile(box[2:] - box[:2], 2)
        limit = np.array([self.camera.width, self.camera.height])
        box = np.clip(box, 0, np.tile(limit, 2))
        middle = np.clip((box[:2] + box[2:]) / 2, 2, limit - 2)
        return np.concatenate([np.minimum(box[:2], middle - 2), np.maximum(box[2:], middle + 2)])

    def range_points(
        self, box: np.ndarray, noise: float, dropout: float, generator: np.random.Generator
    ) -> np.ndarray:
        """(p, 3) points of the range sensor that fall inside a box, world coordinates."""
        rows, columns = self.depth.shape
        first = generator.integers(SCAN)
        i, j = np.mgrid[first[0] : rows : SCAN[0], first[1] : columns : SCAN[1]].reshape(2, -1)
        x, y = (j + 0.5) / COARSE, (i + 0.5) / COARSE
        inside = (x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])
        kept = inside & (generator.random(len(i)) >= dropout)
        points = self.points(i[kept], j[kept], generator.normal(0, noise, kept.sum()))
        return points[np.isfinite(points).all(1)]

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


def look(scene: Scene, camera: Camera) -> Sight:
    """Find the silhouettes of all cars in a frame."""
    coarse, mesh = camera.scaled(COARSE), scene.mesh
    screen, shape = coarse.project(mesh.vertices), (coarse.height, coarse.width)
    nearest, face = rasterise(screen, shape, mesh, scene.atlas)
    owner = np.where(face >= 0, mesh.owner[face], -1)
    whole, seen = np.zeros((2, len(scene.cars), 4))
    visible = np.zeros(len(scene.cars))
    for car in np.unique(owner[owner >= 0]):
        alone = mesh.select(mesh.owner == car)
        corners = screen[alone.faces.ravel()]
        if (corners[:, 2] <= 0).any():
            continue
        rows, columns = np.nonzero(owner == car)
        whole[car] = [*corners[:, :2].min(0), *corners[:, :2].max(0)]
        seen[car] = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        silhouette = rasterise(screen, shape, alone, scene.atlas)[1] >= 0
        visible[car] = len(rows) / silhouette.sum()
    whole, seen = whole / COARSE, seen / COARSE
    inside = np.clip(whole, 0, [camera.width, camera.height, camera.width, camera.height])
    with np.errstate(divide="ignore"):
        depth = 1 / nearest.astype(float)
    return Sight(camera, depth, whole, inside, seen, visible)


def _area(box: np.ndarray) -> np.ndarray:
    return (box[:, 2] - box[:, 0]) * (box[:, 3] - box[:, 1])
