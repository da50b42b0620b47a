"""A small software renderer for the parking lot: textured triangles, sun, hard shadows, reflections.

Deferred shading in two passes. :func:`rasterise` keeps the nearest triangle of each pixel (a
z-buffer); :func:`shade` then finds the perspective-correct texture coordinate, the normal and the
light of each pixel once. The kernels are compiled by numba, run on one core and are deterministic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, no_type_check

import numpy as np
from numba import njit

from mixer_torch.datasets.parking_lot_textures import CHROME, CUT, GLASS, PAINT, Atlas

NEAR = 0.15
SCENERY, FOLIAGE = -1, -2  # owners that are no car; foliage takes no hard shadow
SUN_DEPTH = 1000.0  # added to depths along the sun, so that they are positive
SHADOW_CELL = 0.04  # metres


@dataclass(frozen=True)
class Mesh:
    """Textured triangles. Lengths in metres, z up.

    Args:
        vertices: (v, 3).
        normals: (v, 3), unit length.
        faces: (t, 3) rows of vertices, counter-clockwise seen from outside.
        uv: (t, 3, 2) texture coordinate of each corner; 0 to 1 from the left and from the top.
        tile: (t,) which texture of the atlas.
        owner: (t,) the car a triangle belongs to, or SCENERY or FOLIAGE.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    tile: np.ndarray
    owner: np.ndarray

    @classmethod
    def join(cls, meshes: list[Mesh]) -> Mesh:
        """All triangles in one mesh, in the order given."""
        shift = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
        parts = {
            field.name: np.concatenate([getattr(mesh, field.name) for mesh in meshes])
            for field in fields(cls)
            if field.name != "faces"
        }
        faces = np.concatenate([mesh.faces + k for mesh, k in zip(meshes, shift, strict=False)])
        return cls(faces=faces, **parts)


@dataclass(frozen=True)
class Camera:
    """A pin-hole camera without distortion at a pose.

    Args:
        width: Pixels.
        height: Pixels.
        focal: Focal length in pixels; the principal point is the centre of the image.
        position: (3,) world, metres.
        rotation: (3, 3) rows are the camera's axes (right, down, forward) in the world.
    """

    width: int
    height: int
    focal: float
    position: np.ndarray
    rotation: np.ndarray

    def project(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) of column and row in pixels and inverse depth; inverse depth 0 behind NEAR."""
        local = (points - self.position) @ self.rotation.T
        front = local[:, 2] > NEAR
        depth = np.where(front, local[:, 2], 1.0)
        column = self.width / 2 + self.focal * local[:, 0] / depth
        row = self.height / 2 + self.focal * local[:, 1] / depth
        return np.stack([column, row, front / depth], axis=1).astype(np.float32)

    def scaled(self, factor: float) -> Camera:
        """The same view with another number of pixels."""
        return Camera(
            round(self.width * factor),
            round(self.height * factor),
            self.focal * factor,
            self.position,
            self.rotation,
        )


@dataclass(frozen=True)
class Light:
    """The sun as a direction, what it casts on the scene, and the sky around.

    Args:
        direction: (3,) unit vector towards the sun.
        sun: (3,) linear RGB irradiance of the sun.
        sky: (3,) linear RGB of the light from above.
        bounce: (3,) linear RGB of the light from below.
        panorama: (rows, columns, 3) float32 linear RGB of what is far away, by direction.
        shadow: Depth map seen from the sun.
        axes: (3, 3) rows: two axes across the sun's rays and the direction itself.
        corner: (2,) the coordinates, along the two axes, of the shadow map's first pixel.
    """

    direction: np.ndarray
    sun: np.ndarray
    sky: np.ndarray
    bounce: np.ndarray
    panorama: np.ndarray
    shadow: np.ndarray
    axes: np.ndarray
    corner: np.ndarray

    @classmethod
    def cast(cls, mesh: Mesh, atlas: Atlas, direction: np.ndarray, **colours: Any) -> Light:
        """Light that falls on a mesh from a direction: the shadow map is rendered once."""
        across = np.cross(direction, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(across, direction), direction])
        local = mesh.vertices @ axes.T
        corner = local[:, :2].min(0) - 1.0
        screen = local.copy()
        screen[:, :2] = (local[:, :2] - corner) / SHADOW_CELL
        screen[:, 2] += SUN_DEPTH
        width, height = np.ceil(screen[:, :2].max(0) + 1.0 / SHADOW_CELL).astype(int)
        shadow = np.zeros((height, width), np.float32)
        rasterise(screen.astype(np.float32), mesh, atlas, shadow)
        return cls(direction, shadow=shadow, axes=axes, corner=corner, **colours)


def rasterise(screen: np.ndarray, mesh: Mesh, atlas: Atlas, nearest: np.ndarray) -> np.ndarray:
    """Nearest triangle of each pixel (-1 for none); ``nearest`` receives its inverse depth.

    Args:
        screen: (v, 3) float32 column, row and inverse depth of each vertex; larger is nearer and
            0 is behind the camera.
        mesh: Triangles.
        atlas: Their textures; what is cut out there covers nothing.
        nearest: (height, width) float32, 0 where nothing has been drawn; written to.
    """
    face = np.full(nearest.shape, -1, np.int32)
    _rasterise(
        screen, mesh.faces, mesh.uv, mesh.tile, atlas.cut, atlas.table, atlas.texels, nearest, face
    )
    return face


def coverage(screen: np.ndarray, mesh: Mesh, shape: tuple[int, int], count: int) -> np.ndarray:
    """Number of pixels inside each of a count of cars' silhouettes, whatever stands in front."""
    covered = np.zeros(count, np.int64)
    _coverage(screen, mesh.faces, mesh.owner, np.full(shape, -1, np.int32), covered)
    return covered


def shade(camera: Camera, mesh: Mesh, atlas: Atlas, ground: Any, light: Light) -> np.ndarray:
    """(height, width, 3) float32 linear RGB of the scene; a ground is what is seen at z = 0."""
    screen = camera.project(mesh.vertices)
    nearest = np.zeros((camera.height, camera.width), np.float32)
    face = rasterise(screen, mesh, atlas, nearest)
    image = np.empty((*face.shape, 3), np.float32)
    _shade(
        face,
        screen,
        (camera.focal, camera.position, camera.rotation),
        (mesh.vertices, mesh.normals, mesh.faces, mesh.uv, mesh.tile, mesh.owner),
        (atlas.table, atlas.texels, _level(screen, mesh, atlas)),
        (ground.table, ground.texels, ground.origin, ground.cell, ground.grain),
        (light.direction, light.sun, light.sky, light.bounce),
        (light.shadow, light.axes, light.corner),
        light.panorama,
        image,
    )
    return image


def _level(screen: np.ndarray, mesh: Mesh, atlas: Atlas) -> np.ndarray:
    """Which level of its texture a triangle is drawn with: about one texel a pixel."""
    size = atlas.table[mesh.tile, 0, 2:0:-1]
    texels = mesh.uv * size[:, None]
    wanted = _twice_area(texels) / np.maximum(_twice_area(screen[mesh.faces, :2]), 1e-3)
    level = np.rint(0.5 * np.log2(np.maximum(wanted, 1e-6)) - 0.25)
    return np.clip(level, 0, atlas.table.shape[1] - 1).astype(np.int32)


def _twice_area(corners: np.ndarray) -> np.ndarray:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


@njit(cache=True, error_model="numpy")
@no_type_check
def _rasterise(screen, faces, uv, tile, cut, table, texels, nearest, face):
    height, width = nearest.shape
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay, az = screen[a, 0], screen[a, 1], screen[a, 2]
        bx, by, bz = screen[b, 0], screen[b, 1], screen[b, 2]
        cx, cy, cz = screen[c, 0], screen[c, 1], screen[c, 2]
        if az <= 0.0 or bz <= 0.0 or cz <= 0.0:
            continue
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:
            continue
        left = max(0, int(math.ceil(min(ax, bx, cx) - 0.5)))
        right = min(width - 1, int(math.floor(max(ax, bx, cx) - 0.5)))
        top = max(0, int(math.ceil(min(ay, by, cy) - 0.5)))
        bottom = min(height - 1, int(math.floor(max(ay, by, cy) - 0.5)))
        for i in range(top, bottom + 1):
            y = i + 0.5
            for j in range(left, right + 1):
                x = j + 0.5
                wa = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                wb = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                wc = 1.0 - wa - wb
                if wa < 0.0 or wb < 0.0 or wc < 0.0:
                    continue
                z = wa * az + wb * bz + wc * cz
                if z <= nearest[i, j]:
                    continue
                if cut[tile[t]]:
                    pa, pb, pc = wa * az / z, wb * bz / z, wc * cz / z
                    u = pa * uv[t, 0, 0] + pb * uv[t, 1, 0] + pc * uv[t, 2, 0]
                    v = pa * uv[t, 0, 1] + pb * uv[t, 1, 1] + pc * uv[t, 2, 1]
                    k = tile[t]
                    offset, h, w = table[k, 0, 0], table[k, 0, 1], table[k, 0, 2]
                    r = min(h - 1, max(0, int(v * h)))
                    c = min(w - 1, max(0, int(u * w)))
                    if texels[offset + r * w + c, 3] == CUT:
                        continue
                nearest[i, j] = z
                face[i, j] = t


@njit(cache=True, error_model="numpy")
@no_type_check
def _coverage(screen, faces, owner, stamp, covered):
    """Counts a pixel once for a car: its triangles follow one another, and leave their stamp."""
    height, width = stamp.shape
    for t in range(len(faces)):
        if owner[t] < 0:
            continue
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay, az = screen[a, 0], screen[a, 1], screen[a, 2]
        bx, by, bz = screen[b, 0], screen[b, 1], screen[b, 2]
        cx, cy, cz = screen[c, 0], screen[c, 1], screen[c, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if az <= 0.0 or bz <= 0.0 or cz <= 0.0 or abs(area) < 1e-9:
            continue
        left = max(0, int(math.ceil(min(ax, bx, cx) - 0.5)))
        right = min(width - 1, int(math.floor(max(ax, bx, cx) - 0.5)))
        top = max(0, int(math.ceil(min(ay, by, cy) - 0.5)))
        bottom = min(height - 1, int(math.floor(max(ay, by, cy) - 0.5)))
        for i in range(top, bottom + 1):
            y = i + 0.5
            for j in range(left, right + 1):
                x = j + 0.5
                wa = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                wb = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                if wa < 0.0 or wb < 0.0 or wa + wb > 1.0 or stamp[i, j] == owner[t]:
                    continue
                stamp[i, j] = owner[t]
                covered[owner[t]] += 1


@njit(cache=True, error_model="numpy")
@no_type_check
def _sample(table, texels, tile, level, u, v):
    """Bilinear linear-light RGB (gamma 2) and the nearest material."""
    offset, h, w = table[tile, level, 0], table[tile, level, 1], table[tile, level, 2]
    x = min(max(u * w - 0.5, 0.0), w - 1.001)
    y = min(max(v * h - 0.5, 0.0), h - 1.001)
    j, i = int(x), int(y)
    fx, fy = x - j, y - i
    j1, i1 = min(j + 1, w - 1), min(i + 1, h - 1)
    a, b = offset + i * w + j, offset + i * w + j1
    c, d = offset + i1 * w + j, offset + i1 * w + j1
    wa, wb = (1 - fx) * (1 - fy) / 255.0, fx * (1 - fy) / 255.0
    wc, wd = (1 - fx) * fy / 255.0, fx * fy / 255.0
    red = wa * texels[a, 0] + wb * texels[b, 0] + wc * texels[c, 0] + wd * texels[d, 0]
    green = wa * texels[a, 1] + wb * texels[b, 1] + wc * texels[c, 1] + wd * texels[d, 1]
    blue = wa * texels[a, 2] + wb * texels[b, 2] + wc * texels[c, 2] + wd * texels[d, 2]
    row, column = (i if fy < 0.5 else i1), (j if fx < 0.5 else j1)
    material = texels[offset + row * w + column, 3]
    return red * red, green * green, blue * blue, material


@njit(cache=True, error_model="numpy")
@no_type_check
def _far(panorama, dx, dy, dz):
    """What is seen far away in a direction; rows are spaced by sqrt(|z|), dense at the horizon."""
    rows, columns, _ = panorama.shape
    lift = math.copysign(math.sqrt(abs(dz)), dz)
    y = min(max((0.5 - 0.5 * lift) * rows - 0.5, 0.0), rows - 1.001)
    x = (math.atan2(dy, dx) / (2.0 * math.pi) + 0.5) * columns - 0.5
    i, j = int(y), int(math.floor(x))
    fy, fx = y - i, x - j
    j0, j1 = j % columns, (j + 1) % columns
    wa, wb, wc, wd = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    return (
        wa * panorama[i, j0, 0] + wb * panorama[i, j1, 0]
        + wc * panorama[i + 1, j0, 0] + wd * panorama[i + 1, j1, 0],
        wa * panorama[i, j0, 1] + wb * panorama[i, j1, 1]
        + wc * panorama[i + 1, j0, 1] + wd * panorama[i + 1, j1, 1],
        wa * panorama[i, j0, 2] + wb * panorama[i, j1, 2]
        + wc * panorama[i + 1, j0, 2] + wd * panorama[i + 1, j1, 2],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
@no_type_check
def _sunlit(shadow, axes, corner, x, y, z):
    """Fraction of the sun that arrives at a point, by bilinear comparison with the depth map."""
    rows, columns = shadow.shape
    u = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - corner[0]) / SHADOW_CELL - 0.5
    v = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - corner[1]) / SHADOW_CELL - 0.5
    depth = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z + SUN_DEPTH + 0.07
    j, i = int(math.floor(u)), int(math.floor(v))
    if i < 0 or j < 0 or i >= rows - 1 or j >= columns - 1:
        return 1.0
    fx, fy = u - j, v - i
    top = (1 - fx) * (shadow[i, j] <= depth) + fx * (shadow[i, j + 1] <= depth)
    low = (1 - fx) * (shadow[i + 1, j] <= depth) + fx * (shadow[i + 1, j + 1] <= depth)
    return (1 - fy) * top + fy * low


@njit(cache=True, error_model="numpy")
@no_type_check
def _surface(albedo, material, normal, ray, place, lit, sun_light, panorama, out):
    """Outgoing light of a point: diffuse, and by material a coat that mirrors sky and sun."""
    direction, sun, sky, bounce = sun_light
    nx, ny, nz = normal
    facing = nx * direction[0] + ny * direction[1] + nz * direction[2]
    diffuse = max(facing, 0.0) * lit
    cosine = -(nx * ray[0] + ny * ray[1] + nz * ray[2])
    up = 0.5 + 0.5 * nz
    open_sky = 0.35 + 0.65 * min(1.0, max(0.0, place / 0.7))
    for k in range(3):
        ambient = open_sky * (up * sky[k] + (1.0 - up) * bounce[k])
        out[k] = albedo[k] * (diffuse * sun[k] + ambient)
    if material != PAINT and material != GLASS and material != CHROME:
        return
    base, shine = 0.045, 6.0
    if material == GLASS:
        base, shine = 0.09, 14.0
    if material == CHROME:
        base, shine = 0.45, 10.0
    grazing = 1.0 - min(1.0, max(0.0, cosine))
    mirror = base + (1.0 - base) * grazing**5 * 0.8
    rx, ry, rz = ray[0] + 2 * cosine * nx, ray[1] + 2 * cosine * ny, ray[2] + 2 * cosine * nz
    seen = _far(panorama, rx, ry, rz)
    spark = max(0.0, rx * direction[0] + ry * direction[1] + rz * direction[2])
    glint = lit * shine * (mirror / base) * (spark**350 + 0.02 * spark**24)
    for k in range(3):
        out[k] = out[k] * (1.0 - mirror) + mirror * seen[k] + glint * sun[k] * base


@njit(cache=True, error_model="numpy")
@no_type_check
def _ground(ground, x, y, footprint):
    """Albedo of the ground: the painted lot, coarser with distance, and the grain of asphalt."""
    table, texels, origin, cell, grain = ground
    level = min(max(int(math.log2(max(footprint / cell, 1e-6)) + 0.5), 0), table.shape[1] - 1)
    h, w = table[0, 0, 1], table[0, 0, 2]
    u, v = (x - origin[0]) / (cell * w), (origin[1] - y) / (cell * h)
    red, green, blue, _ = _sample(table, texels, 0, level, u, v)
    n = grain.shape[0]
    fade = max(0.0, 1.0 - footprint / 0.05)
    rough = 1.0 + fade * grain[int(math.floor(y / 0.012)) % n, int(math.floor(x / 0.012)) % n]
    return red * rough, green * rough, blue * rough


@njit(cache=True, error_model="numpy")
@no_type_check
def _shade(face, screen, camera, mesh, atlas, ground, sun_light, shadow, panorama, image):
    focal, position, rotation = camera
    vertices, normals, faces, uv, tile, owner = mesh
    table, texels, level = atlas
    depths, axes, corner = shadow
    height, width = face.shape
    out = np.zeros(3)
    for i in range(height):
        for j in range(width):
            lx, ly = (j + 0.5 - width / 2) / focal, (i + 0.5 - height / 2) / focal
            scale = 1.0 / math.sqrt(lx * lx + ly * ly + 1.0)
            dx = (rotation[0, 0] * lx + rotation[1, 0] * ly + rotation[2, 0]) * scale
            dy = (rotation[0, 1] * lx + rotation[1, 1] * ly + rotation[2, 1]) * scale
            dz = (rotation[0, 2] * lx + rotation[1, 2] * ly + rotation[2, 2]) * scale
            t = face[i, j]
            if t >= 0:
                a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
                x, y = j + 0.5, i + 0.5
                ax, ay, bx, by = screen[a, 0], screen[a, 1], screen[b, 0], screen[b, 1]
                cx, cy = screen[c, 0], screen[c, 1]
                wa = ((bx - x) * (cy - y) - (by - y) * (cx - x)) * screen[a, 2]
                wb = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) * screen[b, 2]
                wc = ((ax - x) * (by - y) - (ay - y) * (bx - x)) * screen[c, 2]
                total = wa + wb + wc
                wa, wb, wc = wa / total, wb / total, wc / total
                u = wa * uv[t, 0, 0] + wb * uv[t, 1, 0] + wc * uv[t, 2, 0]
                v = wa * uv[t, 0, 1] + wb * uv[t, 1, 1] + wc * uv[t, 2, 1]
                x = wa * vertices[a, 0] + wb * vertices[b, 0] + wc * vertices[c, 0]
                y = wa * vertices[a, 1] + wb * vertices[b, 1] + wc * vertices[c, 1]
                z = wa * vertices[a, 2] + wb * vertices[b, 2] + wc * vertices[c, 2]
                nx = wa * normals[a, 0] + wb * normals[b, 0] + wc * normals[c, 0]
                ny = wa * normals[a, 1] + wb * normals[b, 1] + wc * normals[c, 1]
                nz = wa * normals[a, 2] + wb * normals[b, 2] + wc * normals[c, 2]
                norm = math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
                n = (nx / norm, ny / norm, nz / norm)
                red, green, blue, material = _sample(table, texels, tile[t], level[t], u, v)
                lit = _sunlit(depths, axes, corner, x, y, z) if owner[t] > FOLIAGE else 1.0
                place = z if owner[t] >= 0 else 1.0
                albedo = (red, green, blue)
                ray = (dx, dy, dz)
                _surface(albedo, material, n, ray, place, lit, sun_light, panorama, out)
                for k in range(3):
                    image[i, j, k] = out[k]
            elif dz < -1e-4 and -position[2] / dz < 90.0:
                reach = -position[2] / dz
                x, y = position[0] + reach * dx, position[1] + reach * dy
                footprint = reach / focal * math.sqrt(reach / position[2])
                albedo = _ground(ground, x, y, footprint)
                lit = _sunlit(depths, axes, corner, x, y, 0.0)
                up = (0.0, 0.0, 1.0)
                _surface(albedo, 0, up, (dx, dy, dz), 1.0, lit, sun_light, panorama, out)
                for k in range(3):
                    image[i, j, k] = out[k]
            else:
                image[i, j, 0], image[i, j, 1], image[i, j, 2] = _far(panorama, dx, dy, dz)
