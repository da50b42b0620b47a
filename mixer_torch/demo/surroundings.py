"""What stands around the parking lot: buildings, trees, a hedge, lamp posts, and the sky."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from mixer_torch.demo.kernels import FOLIAGE, PANORAMA, SCENERY
from mixer_torch.demo.rendering import Mesh
from mixer_torch.demo.textures import GLASS, HOLE, MATTE, Canvas, smooth_noise

PIECE = 3.0  # metres: longer surfaces are divided, as triangles are not clipped
PLASTER = ((168, 84, 66), (196, 186, 168), (150, 152, 155), (205, 176, 130))
FRAME, BLIND = (225, 224, 218), (208, 200, 182)  # of windows
CLOUDS = ((64, 0.5), (28, 0.3), (12, 0.2), (5, 0.1))  # cells of noise and their weights
SIGNS = ("SUPERMARKT", "BAKERY", "PHARMACY", "HOTEL", "GARAGE 24H", "LIBRARY")


def surroundings(
    half_size: np.ndarray, first_tile: int, generator: np.random.Generator
) -> tuple[list[Mesh], list[np.ndarray]]:
    """Triangles and textures of the scenery around a lot.

    Args:
        half_size: (2,) distances of the outer bays' far edges from the middle.
        first_tile: Number of the first of the textures in the atlas.
        generator: Draws.
    """
    x, y = half_size + np.array([4.0, 3.0])
    meshes: list[Mesh] = []
    textures: list[np.ndarray] = []
    for start, end, height in (  # buildings
        ((-x - 3, y + 5), (x + 3, y + 5), 8.0),
        ((x + 6, 14), (x + 6, -10), 10.0),
        ((-x - 7, -16), (-x - 7, 0), 6.0),
    ):
        meshes.append(_wall(start, end, height, first_tile + len(textures)))
        textures.append(_building(math.dist(start, end), height, generator))
    hedge = Canvas(2 * x, 1.1, (42, 62, 28), MATTE, 40)
    hedge.mottle(generator, 0.1, 0.4)
    meshes.append(_wall((x, -y), (-x, -y), 1.1, first_tile + len(textures)))
    textures.append(hedge.texture)
    for _ in range(3):  # kinds of trees
        for _ in range(6):
            across, beyond, wide, high = generator.uniform([-1, 1, 4, 5], [1, 6, 6, 9])
            sides = ((across * x, -y - beyond), (x + beyond, across * y), (-x - beyond, across * y))
            spot = sides[generator.choice(3, p=[0.6, 0.2, 0.2])]
            for part in _crossed(spot, wide, high, first_tile + len(textures), FOLIAGE):
                meshes.append(replace(part, normals=np.full_like(part.normals, [0, 0, 1])))
        textures.append(_tree(generator))
    posts = [(s * x / 2, t * (y - 1)) for s in (-1, 1) for t in (-1, 1)]
    for foot in (*posts, (2 - x, 0.0), (x - 2, 0.0)):
        meshes += _crossed(foot, 0.14, 6.5, first_tile + len(textures), SCENERY)
    textures.append(Canvas(0.3, 6.0, (120, 124, 126), MATTE, 40).texture)
    return meshes, textures


def _wall(start: Any, end: Any, height: float, tile: int, owner: int = SCENERY) -> Mesh:
    """An upright surface from start to end, lit on its right."""
    count = math.ceil(math.dist(start, end) / PIECE)
    v, u = np.meshgrid([0.0, 1.0], np.linspace(0, 1, count + 1), indexing="ij")
    feet = np.asarray(start) + u[..., None] * (np.asarray(end) - start)
    return Mesh.grid(np.dstack([feet, height * (1 - v)]), np.dstack([u, v]), tile, owner)


def _crossed(foot: Any, width: float, height: float, tile: int, owner: int) -> list[Mesh]:
    """Two crossed upright surfaces, for what is round."""
    halves = np.array([[width / 2, 0.0], [0.0, width / 2]])
    return [_wall(foot - half, foot + half, height, tile, owner) for half in halves]


def _building(width: float, height: float, generator: np.random.Generator) -> np.ndarray:
    """A facade with rows of windows, a door, a sign and a plinth."""
    wall = np.array(PLASTER[generator.integers(len(PLASTER))], float)
    canvas = Canvas(width, height, wall, MATTE, 40)
    for y in np.arange(0.0, height, 0.4):
        canvas.line([(0, y), (width, y)], wall * 0.9, 0.025)
    canvas.rectangle(0, 0, width, 0.7, wall * 0.6)
    step = generator.uniform(2.2, 3.4)
    for y in np.arange(1.2, height - 1.6, 2.9):
        for x in np.arange(0.8, width - 1.6, step):
            if generator.random() < 0.12:
                continue
            tint = generator.uniform(25, 80) * np.array([0.8, 0.95, 1.1])
            canvas.rectangle(x - 0.08, y - 0.08, 1.36, 1.56, FRAME)
            canvas.rectangle(x, y, 1.2, 1.4, tint, GLASS)
            canvas.rectangle(x + 0.57, y, 0.06, 1.4, FRAME)
            blind = max(0.0, generator.uniform(-1.5, 0.9))
            canvas.rectangle(x, y + 1.4 - blind, 1.2, blind, BLIND)
    door = generator.uniform(0.2, 0.7) * width
    canvas.rectangle(door, 0, 1.5, 2.3, generator.uniform(30, 120, 3))
    canvas.rectangle(door - 1.5, 2.75, 5.2, 0.95, generator.uniform(20, 210, 3))
    canvas.text(door - 1.3, 2.95, generator.choice(SIGNS), 0.5, (240, 240, 235))
    canvas.rectangle(0, height - 0.3, width, 0.3, wall * 0.5)
    canvas.mottle(generator, 1.5, 0.06)
    return canvas.texture


def _tree(generator: np.random.Generator) -> np.ndarray:
    """A trunk and a crown of leaves with gaps."""
    canvas = Canvas(4.0, 6.0, (40, 60, 28), HOLE, 44)
    canvas.polygon([(1.85, 0), (2.15, 0), (2.08, 3), (1.92, 3)], (70, 56, 42), MATTE)
    base = generator.uniform(0.9, 1.3) * np.array([66, 78, 44])
    clumps = generator.normal([2.0, 3.9], [0.75, 0.85], (26, 2))
    for middle in clumps[generator.integers(len(clumps), size=2600)]:
        x, y = middle + generator.normal(0, 0.27, 2)
        sunny = 0.35 + 0.5 * (y - middle[1] + 0.4) + 0.1 * (y - 3.0)
        shade = base * np.clip(sunny + generator.uniform(-0.15, 0.35), 0.25, 1.5)
        canvas.ellipse(x, y, generator.uniform(0.03, 0.09), 0.05, shade, MATTE)
    return canvas.texture


def panorama(sun: np.ndarray, harshness: float, generator: np.random.Generator) -> np.ndarray:
    """What is far away, as Light has it: sky with clouds, the sun's glow, far trees, grass.

    Columns are azimuth from -pi to pi, rows (1 - sign(z) sqrt(abs(z))) / 2 of the direction.
    """
    rows, columns = PANORAMA
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * np.pi - np.pi
    lift = 1 - 2 * (np.arange(rows)[:, None] + 0.5) / rows
    z = np.sign(lift) * lift**2
    level = np.sqrt(1 - z**2)
    toward = level * (np.cos(azimuth) * sun[0] + np.sin(azimuth) * sun[1]) + z * sun[2]
    blend = np.clip(z, 0, 1)[..., None] ** 0.45
    sky = (1 - blend) * np.array([0.88, 0.94, 1.0]) + blend * np.array([0.20, 0.38, 0.80])
    # Clouds are noise on a flat layer high above, so that they thin to streaks at the horizon.
    layer = sum(w * smooth_noise(generator, (512, 512), c) for c, w in CLOUDS)
    reach = 40.0 * level / (np.clip(z, 0, 1) + 0.16)
    column = (256 + reach * np.cos(azimuth)).astype(np.float32)
    row = (256 + reach * np.sin(azimuth)).astype(np.float32)
    layer = np.asarray(layer)
    noise = cv2.remap(layer, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    cloud = (np.clip(1.1 * noise - 0.1, 0, 0.85) * np.clip(z * 12, 0, 1))[..., None]
    glow = np.clip(toward, 0, 1)[..., None]
    glow = harshness * (0.8 * glow**12 + 30.0 * glow**900) * np.array([1.0, 0.93, 0.8])
    leaves = 1 + 0.35 * smooth_noise(generator, PANORAMA, 5)[..., None]
    ridge = 0.035 + 0.012 * smooth_noise(generator, (1, columns), 60)
    image = np.where((z < ridge)[..., None], leaves * np.array([0.075, 0.11, 0.06]),
                     sky * (1 - cloud) + 1.2 * cloud + glow)  # fmt: skip
    image = np.where((z < 0)[..., None], [0.17, 0.17, 0.165], image)
    return (255 * np.sqrt(np.maximum(image, 0))).astype(np.float32).reshape(-1, 3)
