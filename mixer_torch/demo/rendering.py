"""A small software renderer for the parking lot: textured triangles, sun and hard shadows.

Deferred shading in two passes. :func:`rasterise` keeps the nearest triangle of each pixel (a
z-buffer); :func:`shade` then finds the perspective-correct texture coordinate, the normal and the
light of each pixel once.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mixer_torch.demo import kernels
from mixer_torch.demo.kernels import SHADOW_CELL, SUN_DEPTH
from mixer_torch.demo.textures import Atlas

NEAR = 0.15


@dataclass(frozen=True)
class Mesh:
    """Textured triangles. Lengths in metres, z up.

    Args:
        vertices: (v, 3).
        normals: (v, 3), unit length.
        faces: (t, 3) rows of vertices, counter-clockwise seen from outside.
        uv: (t, 3, 2) texture coordinate of each corner; 0 to 1 from the left and from the top.
        tile: (t,) which texture of the atlas.
        owner: (t,) the car a triangle belongs to, or the kernels' SCENERY or FOLIAGE.
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
    kernels.rasterise(
        screen, mesh.faces, mesh.uv, mesh.tile, atlas.cut, atlas.table, atlas.texels, nearest, face
    )
    return face


def coverage(screen: np.ndarray, mesh: Mesh, shape: tuple[int, int], count: int) -> np.ndarray:
    """Number of pixels inside each of a count of cars' silhouettes, whatever stands in front."""
    covered = np.zeros(count, np.int64)
    kernels.coverage(screen, mesh.faces, mesh.owner, np.full(shape, -1, np.int32), covered)
    return covered


def shade(camera: Camera, mesh: Mesh, atlas: Atlas, ground: Any, light: Light) -> np.ndarray:
    """(height, width, 3) float32 linear RGB of the scene; a ground is what is seen at z = 0."""
    screen = camera.project(mesh.vertices)
    nearest = np.zeros((camera.height, camera.width), np.float32)
    face = rasterise(screen, mesh, atlas, nearest)
    image = np.empty((*face.shape, 3), np.float32)
    view = np.concatenate([camera.rotation, camera.position[None], np.full((1, 3), camera.focal)])
    shadow = (light.shadow, light.axes, light.corner)
    colours = np.stack([light.direction, light.sun, light.sky, light.bounce])
    arrays = (mesh.vertices, mesh.normals, mesh.faces, mesh.uv, mesh.tile, mesh.owner)
    levels = (atlas.table, atlas.texels, _level(screen, mesh, atlas))
    below = (ground.table, ground.texels, ground.origin, ground.cell, ground.grain)
    kernels.shade_faces(face, screen, view, arrays, levels, shadow, colours, light.panorama, image)
    kernels.shade_rest(face, view, below, shadow, colours, light.panorama, image)
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
