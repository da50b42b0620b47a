"""What stands around the parking lot: buildings, trees, a fence, lamp posts, and the sky."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mixer_torch.demo.kernels import FOLIAGE, SCENERY
from mixer_torch.demo.rendering import Mesh
from mixer_torch.demo.textures import CHROME, CUT, GLASS, MATTE, Canvas, blotches

PIECE = 3.0  # metres: longer surfaces are divided, as triangles are not clipped
PLASTER = ((168, 84, 66), (196, 186, 168), (150, 152, 155), (205, 176, 130))
SIGNS = ("SUPERMARKT", "BAKERY", "PHARMACY", "HOTEL", "GARAGE 24H", "LIBRARY")


def surroundings(
    half_size: np.ndarray, bays: np.ndarray, first_tile: int, generator: np.random.Generator
) -> tuple[Mesh, list[np.ndarray]]:
    """Triangles and textures of the scenery around a lot.

    Args:
        half_size: (2,) distances of the outer bays' far edges from the middle.
        bays: (n, 3) x, y and the direction to the aisle, of each bay.
        first_tile: Number of the first of the textures in the atlas.
        generator: Draws.
    """
    x, y = half_size[0] + 4.0, half_size[1] + 3.0
    meshes: list[Mesh] = []
    textures: list[np.ndarray] = []

    def add(mesh_of: Any, texture: np.ndarray, places: list) -> None:
        meshes.extend(mesh_of(*place, first_tile + len(textures)) for place in places)
        textures.append(texture)

    add(_wall, _building(2 * x + 6, 8.0, generator),
        [((-x - 3, y + 5), (x + 3, y + 5), 8.0)])  # fmt: skip
    add(_wall, _building(24.0, 10.0, generator), [((x + 6, 14), (x + 6, -10), 10.0)])
    add(_wall, _building(16.0, 6.0, generator), [((-x - 7, -16), (-x - 7, 0), 6.0)])
    add(_wall, _hedge(2 * x, 1.1, generator), [((x, -y), (-x, -y), 1.1)])
    add(_wall, _fence(12.0, 1.7), [((-x, s * k), (-x, s * (k + 12)), 1.7)
                                   for s, k in ((1, 2), (-1, 4))])  # fmt: skip
    for _ in range(3):
        spots = [_beyond(x, y, generator) for _ in range(6)]
        add(
            _billboard,
            _tree(generator),
            [(spot, *generator.uniform([4, 5], [6, 9])) for spot in spots],
        )
    post = Canvas(0.3, 6.0, (120, 124, 126), MATTE, 40)
    post.rectangle(0, 0, 0.3, 0.5, (205, 180, 40))
    corners = [(-0.5 * x, -y + 1), (0.5 * x, -y + 1), (-0.5 * x, y - 1), (0.5 * x, y - 1)]
    posts = [(spot, 0.14, 6.5) for spot in [*corners, (-x + 2, 0.0), (x - 2, 0.0)]]
    add(_post, post.texture(), posts)
    stop = Canvas(1.7, 0.12, (150, 148, 142), MATTE, 60)
    stop.rectangle(0.2, 0, 0.3, 0.12, (178, 150, 40))
    stop.rectangle(1.2, 0, 0.3, 0.12, (178, 150, 40))
    add(_wheel_stop, stop.texture(), [(bay,) for bay in bays])
    return Mesh.join(meshes), textures


def _beyond(x: float, y: float, generator: np.random.Generator) -> np.ndarray:
    """A place for a tree outside of the lot."""
    along, side = generator.uniform(-1, 1), generator.choice([-1, 1])
    if generator.random() < 0.55:
        return np.array([along * x, -y - generator.uniform(1, 7)])
    return np.array([side * (x + generator.uniform(0.5, 5)), along * y])


def _quads(corners: np.ndarray, uv: np.ndarray, normals: np.ndarray, tile: int) -> Mesh:
    """Quads (q, 4, 3), one normal each, as triangles."""
    count = len(corners)
    index = np.arange(4 * count).reshape(count, 4)
    faces = np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]])
    flat = uv.reshape(-1, 2)
    return Mesh(
        corners.reshape(-1, 3).astype(float),
        np.repeat(normals.astype(float), 4, axis=0),
        faces,
        flat[faces],
        np.full(len(faces), tile),
        np.full(len(faces), SCENERY),
    )


def _wall(start: Any, end: Any, height: float, tile: int) -> Mesh:
    """An upright surface from start to end, seen from its right; cut into pieces."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    count = max(1, math.ceil(np.linalg.norm(end - start) / PIECE))
    cuts = np.linspace(0, 1, count + 1)
    feet = start + cuts[:, None] * (end - start)
    low, high = np.zeros((count + 1, 1)), np.full((count + 1, 1), height)
    bottom, top = np.concatenate([feet, low], 1), np.concatenate([feet, high], 1)
    corners = np.stack([bottom[:-1], bottom[1:], top[1:], top[:-1]], axis=1)
    a, b, one, nil = cuts[:-1], cuts[1:], np.ones(count), np.zeros(count)
    uv = np.stack([np.stack([a, one], 1), np.stack([b, one], 1),
                   np.stack([b, nil], 1), np.stack([a, nil], 1)], axis=1)  # fmt: skip
    along = (end - start) / np.linalg.norm(end - start)
    normal = np.array([along[1], -along[0], 0.0])
    return _quads(corners, uv, np.tile(normal, (count, 1)), tile)


def _billboard(foot: Any, width: float, height: float, tile: int) -> Mesh:
    """Two crossed upright surfaces, for what is round."""
    sides = []
    for across in (np.array([width / 2, 0.0]), np.array([0.0, width / 2])):
        mesh = _wall(foot - across, foot + across, height, tile)
        up = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
        owner = np.full(len(mesh.faces), FOLIAGE)
        sides.append(Mesh(mesh.vertices, up, mesh.faces, mesh.uv, mesh.tile, owner))
    return Mesh.join(sides)


def _post(foot: Any, width: float, height: float, tile: int) -> Mesh:
    """A square post."""
    return _prism(foot, width, width, height, tile)


def _wheel_stop(bay: np.ndarray, tile: int) -> Mesh:
    """A concrete block at the head of a bay (x, y, direction to the aisle)."""
    ahead = np.array([math.cos(bay[2]), math.sin(bay[2])])
    size = np.abs(1.7 * ahead[::-1]) + np.abs(0.15 * ahead)
    return _prism(bay[:2] - 2.15 * ahead, size[0], size[1], 0.11, tile)


def _prism(foot: Any, width: float, thickness: float, height: float, tile: int) -> Mesh:
    x, y = width / 2, thickness / 2
    ring = np.asarray(foot) + np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    sides = [_wall(ring[k], ring[(k + 1) % 4], height, tile) for k in range(4)]
    lid = np.concatenate([ring, np.full((4, 1), height)], axis=1)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], float)
    return Mesh.join([*sides, _quads(lid[None], uv[None], np.array([[0, 0, 1.0]]), tile)])


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
            canvas.rectangle(x - 0.08, y - 0.08, 1.36, 1.56, (225, 224, 218))
            canvas.rectangle(x, y, 1.2, 1.4, tint, GLASS)
            canvas.rectangle(x + 0.57, y, 0.06, 1.4, (225, 224, 218), MATTE)
            if generator.random() < 0.4:
                blind = generator.uniform(0.2, 0.9)
                canvas.rectangle(x, y + 1.4 - blind, 1.2, blind, (208, 200, 182), MATTE)
    door = generator.uniform(0.2, 0.7) * width
    canvas.rectangle(door, 0, 1.5, 2.3, generator.uniform(30, 120, 3), MATTE)
    words = SIGNS[generator.integers(len(SIGNS))]
    canvas.rectangle(door - 1.5, 2.75, 5.2, 0.95, generator.uniform(20, 210, 3), MATTE)
    canvas.text(door - 1.3, 2.95, words, 0.5, (240, 240, 235))
    canvas.rectangle(0, height - 0.3, width, 0.3, wall * 0.5)
    canvas.mottle(generator, 1.5, 0.06)
    return canvas.texture()


def _hedge(width: float, height: float, generator: np.random.Generator) -> np.ndarray:
    """Leaves of many greens, with an uneven upper edge."""
    canvas = Canvas(width, height, (38, 56, 26), MATTE, 40)
    for _ in range(int(60 * width)):
        x, y = generator.uniform(0, width), generator.uniform(0, height)
        shade = generator.uniform(0.5, 1.6) * np.array([52, 78, 34])
        canvas.ellipse(x, y, 0.06, 0.05, shade)
    canvas.material[:6] = np.where(
        blotches(generator, (6, canvas.material.shape[1]), 5) > 0, CUT, MATTE
    )
    return canvas.texture()


def _fence(width: float, height: float) -> np.ndarray:
    """Bars and rails; between them one sees through."""
    canvas = Canvas(width, height, (70, 74, 78), CUT, 40)
    for y in (0.1, height - 0.15):
        canvas.rectangle(0, y, width, 0.06, (70, 74, 78), CHROME)
    for x in np.arange(0.0, width, 0.25):
        thick = 0.1 if round(x / 0.25) % 10 == 0 else 0.03
        canvas.rectangle(x, 0, thick, height, (70, 74, 78), CHROME)
    return canvas.texture()


def _tree(generator: np.random.Generator) -> np.ndarray:
    """A trunk and a crown of leaves with gaps."""
    canvas = Canvas(4.0, 6.0, (40, 60, 28), CUT, 44)
    canvas.polygon([(1.85, 0), (2.15, 0), (2.08, 3), (1.92, 3)], (70, 56, 42), MATTE)
    base = generator.uniform(0.9, 1.3) * np.array([66, 78, 44])
    clumps = generator.normal([2.0, 3.9], [0.75, 0.85], (26, 2))
    for _ in range(2600):
        middle = clumps[generator.integers(len(clumps))]
        x, y = middle + generator.normal(0, 0.27, 2)
        sunny = 0.35 + 0.5 * (y - middle[1] + 0.4) + 0.2 * (y - 3.0) / 2.0
        shade = base * np.clip(sunny + generator.uniform(-0.15, 0.35), 0.25, 1.5)
        canvas.ellipse(x, y, generator.uniform(0.03, 0.09), 0.05, shade, MATTE)
    return canvas.texture()


def panorama(direction: Any, harshness: float, generator: np.random.Generator) -> np.ndarray:
    """(rows, columns, 3) linear RGB by direction: sky with clouds, sun glow, far trees, ground.

    Columns are azimuth from -pi to pi, rows (1 - sign(z) sqrt(abs(z))) / 2 of the direction.
    """
    rows, columns = 384, 1536
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * np.pi - np.pi
    lift = 1 - 2 * (np.arange(rows)[:, None] + 0.5) / rows
    z = np.sign(lift) * lift**2
    level = np.sqrt(1 - z**2)
    toward = (
        level * (np.cos(azimuth) * direction[0] + np.sin(azimuth) * direction[1]) + z * direction[2]
    )
    blend = np.clip(z, 0, 1)[..., None] ** 0.45
    sky = (1 - blend) * np.array([0.88, 0.94, 1.0]) + blend * np.array([0.20, 0.38, 0.80])
    cloud = _clouds(z, azimuth, generator)[..., None]
    image = sky * (1 - cloud) + 1.2 * cloud
    glow = np.clip(toward, 0, 1)[..., None]
    image = image + harshness * (0.8 * glow**12 + 30.0 * glow**900) * np.array([1.0, 0.93, 0.8])
    ridge = 0.035 + 0.012 * blotches(generator, (1, columns), 90)
    ridge = ridge + 0.008 * blotches(generator, (1, columns), 14)
    trees = np.array([0.075, 0.11, 0.06]) * (
        1 + 0.35 * blotches(generator, (rows, columns), 5)[..., None]
    )
    image = np.where((z < ridge)[..., None], trees, image)
    image = np.where((z < 0)[..., None], np.array([0.17, 0.17, 0.165]), image)
    return np.ascontiguousarray(image, dtype=np.float32)


def _clouds(z: np.ndarray, azimuth: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Cover of the sky by direction: noise on a flat layer high above, so it thins to streaks."""
    import cv2

    size = 512
    layer = sum(
        weight * blotches(generator, (size, size), cell)
        for cell, weight in ((64, 0.5), (28, 0.3), (12, 0.2), (5, 0.1))
    )
    reach = 40.0 * np.sqrt(np.clip(1 - z**2, 0, 1)) / (np.clip(z, 0, 1) + 0.16)
    column = (size / 2 + reach * np.cos(azimuth)).astype(np.float32)
    row = (size / 2 + reach * np.sin(azimuth)).astype(np.float32)
    layer = np.asarray(layer, np.float32)
    noise = cv2.remap(layer, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.clip(1.1 * noise - 0.1, 0, 0.85) * np.clip(z * 12, 0, 1)
