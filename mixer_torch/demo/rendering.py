"""A small software renderer for the parking lot: textured triangles, sun and hard shadows.

Deferred shading in two passes. :func:`rasterise` keeps the nearest triangle of each pixel (a
z-buffer); :func:`shade` then finds the perspective-correct texture coordinate, the normal and the
light of each pixel once.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from mixer_torch.demo import kernels
from mixer_torch.demo.textures import Atlas

NEAR = 0.15  # metres; triangles with a corner nearer than that are not drawn


@dataclass(frozen=True)
class Mesh:
    """Textured triangles. Lengths in metres, z up.

    Args:
        vertices: (v, 3).
        normals: (v, 3), unit length.
        faces: (t, 3) rows of vertices.
        uv: (t, 3, 2) texture coordinate of each corner; 0 to 1 from the left and from the top.
        tile: (t,) which texture of the atlas.
        owner: (t,) the car a triangle belongs to, or the kernels' SCENERY, FOLIAGE or GROUND.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    tile: np.ndarray
    owner: np.ndarray

    @classmethod
    def grid(cls, points: np.ndarray, uv: np.ndarray, tile: int, owner: int) -> Mesh:
        """A smooth surface through (rows, columns, 3) points; uv is (rows, columns, 2).

        It faces where the cross product of the rows' direction and the columns' points to.
        """
        rows, columns = points.shape[:2]
        index = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
        faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
        normals = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1)).reshape(-1, 3)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
        tiles, owners = np.full(len(faces), tile), np.full(len(faces), owner)
        return cls(points.reshape(-1, 3), normals, faces, uv.reshape(-1, 2)[faces], tiles, owners)

    def select(self, kept: np.ndarray) -> Mesh:
        """Some of the triangles, by a mask; all vertices stay."""
        parts = {name: getattr(self, name)[kept] for name in ("faces", "uv", "tile", "owner")}
        return replace(self, **parts)

    @classmethod
    def join(cls, meshes: list[Mesh]) -> Mesh:
        """All triangles in one mesh, in the order given."""
        first = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
        moved = [replace(m, faces=m.faces + k) for m, k in zip(meshes, first, strict=False)]
        names = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([getattr(mesh, name) for mesh in moved]) for name in names))


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
        """(n, 3) column, row and inverse depth (0 behind the camera) of world points (n, 3)."""
        local = (points - self.position) @ self.rotation.T
        front = local[:, 2] > NEAR
        depth = np.where(front, local[:, 2], 1.0)
        column = self.width / 2 + self.focal * local[:, 0] / depth
        row = self.height / 2 + self.focal * local[:, 1] / depth
        return np.stack([column, row, front / depth], axis=1).astype(np.float32)

    def scaled(self, factor: float) -> Camera:
        """The same view with another number of pixels."""
        width, height = round(self.width * factor), round(self.height * factor)
        return replace(self, width=width, height=height, focal=self.focal * factor)


@dataclass(frozen=True)
class Light:
    """The sun, what it casts on the scene, and the sky around.

    Args:
        colours: (4, 3) unit vector towards the sun; linear RGB of the sun's irradiance, of the
            light from above and of that from below.
        panorama: What is far away by direction: 255 times the square root of linear RGB, float32,
            its kernels.PANORAMA rows and columns flattened.
        shadow: Depth map seen from the sun.
        axes: (3, 3) rows: two axes across the sun's rays and the direction itself.
        corner: (3,) coordinates along the axes of the map's first pixel, and of its depth 0.
    """

    colours: np.ndarray
    panorama: np.ndarray
    shadow: np.ndarray
    axes: np.ndarray
    corner: np.ndarray

    @classmethod
    def cast(cls, mesh: Mesh, atlas: Atlas, colours: np.ndarray, panorama: np.ndarray) -> Light:
        """Light that falls on a mesh: the shadow map is rendered once."""
        direction = colours[0]
        across = np.cross(direction, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(across, direction), direction])
        local = mesh.vertices @ axes.T
        corner = local.min(0) - 1.0  # a metre of room around
        screen = (local - corner) / [kernels.SHADOW_CELL, kernels.SHADOW_CELL, 1.0]
        size = np.ceil(screen[:, :2].max(0) + 1.0 / kernels.SHADOW_CELL).astype(int)
        shadow, _ = rasterise(screen.astype(np.float32), tuple(size[::-1].tolist()), mesh, atlas)
        return cls(colours, panorama, shadow, axes, corner)


def rasterise(
    screen: np.ndarray, shape: tuple[int, int], mesh: Mesh, atlas: Atlas
) -> tuple[np.ndarray, np.ndarray]:
    """Draw all triangles that lie before the camera.

    Args:
        screen: (v, 3) float32 column, row and inverse depth of each vertex; larger is nearer and
            0 is behind the camera.
        shape: Of the image, rows and columns.
        mesh: Triangles.
        atlas: Their textures; the holes of foliage cover nothing.

    Returns:
        Of each pixel the nearest inverse depth (0 for none) and its triangle (-1).
    """
    nearest, face = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
    textures = (mesh.uv, mesh.tile, mesh.owner, atlas.table, atlas.texels)
    kernels.rasterise(screen, mesh.faces, *textures, nearest, face)
    return nearest, face


def shade(camera: Camera, mesh: Mesh, atlas: Atlas, light: Light, grain: np.ndarray) -> np.ndarray:
    """(height, width, 3) float32 linear RGB; grain is a square tile of the asphalt's roughness."""
    screen = camera.project(mesh.vertices)
    _, face = rasterise(screen, (camera.height, camera.width), mesh, atlas)
    image = np.empty((*face.shape, 3), np.float32)
    view = np.concatenate([camera.rotation, camera.position[None], np.full((1, 3), camera.focal)])
    meshes, lights = (tuple(vars(part).values()) for part in (mesh, light))
    kernels.shade(face, screen, view, meshes, (atlas.table, atlas.texels, grain), lights, image)
    return image
