"""Textures of the parking lot: an atlas with coarser levels, and a canvas measured in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

CUT, MATTE, PAINT, GLASS, CHROME = 0, 60, 120, 180, 240
LEVELS = 4


@dataclass(frozen=True)
class Atlas:
    """Textures of any sizes, one after another, each with LEVELS levels of half the size.

    Args:
        table: (tiles, LEVELS, 3) int64: first texel, rows and columns.
        texels: (n, 4) uint8: gamma-2 RGB and material (CUT, MATTE, PAINT, GLASS or CHROME).
        cut: (tiles,) bool: whether a texture has holes.
    """

    table: np.ndarray
    texels: np.ndarray
    cut: np.ndarray

    @classmethod
    def pack(cls, textures: Sequence[np.ndarray]) -> Atlas:
        """Textures, each (rows, columns, 4) uint8 RGB and material, in the order of their tiles."""
        import cv2

        table = np.zeros((len(textures), LEVELS, 3), np.int64)
        parts, first = [], 0
        for tile, texture in enumerate(textures):
            rgb, material = np.ascontiguousarray(texture[..., :3]), texture[..., 3].copy()
            for level in range(LEVELS):
                if level:
                    half = tuple(max(2, side >> level) for side in texture.shape[1::-1])
                    rgb = cv2.resize(rgb, half, interpolation=cv2.INTER_AREA)
                    material = cv2.resize(material, half, interpolation=cv2.INTER_NEAREST)
                rows, columns = material.shape
                table[tile, level] = first, rows, columns
                parts.append(np.dstack([rgb, material]).reshape(-1, 4))
                first += rows * columns
        cut = np.array([(texture[..., 3] == CUT).any() for texture in textures])
        return cls(table, np.concatenate(parts), cut)


class Canvas:
    """A texture to draw on in metres, with the origin at the lower left.

    Args:
        width: float.
        height: float.
        colour: RGB of the blank canvas.
        material: Its material.
        density: Pixels a metre.
    """

    def __init__(
        self,
        width: float,
        height: float,
        colour: Any,
        material: int = PAINT,
        density: float = 110,
    ) -> None:
        self.density = density
        self.size = (width, height)
        shape = (max(2, round(height * density)), max(2, round(width * density)))
        self.rgb = np.empty((*shape, 3), np.uint8)
        self.rgb[:] = colour
        self.material = np.full(shape, material, np.uint8)

    def _pixels(self, points: Any) -> np.ndarray:
        points = np.asarray(points, float).reshape(-1, 2)
        flipped = np.stack([points[:, 0], self.size[1] - points[:, 1]], axis=1)
        return np.rint(flipped * self.density * 8).astype(np.int32)

    def polygon(self, points: Any, colour: Any, material: int | None = None) -> None:
        """Fill a polygon of (n, 2) metres; the material stays where none is given."""
        import cv2

        corners = self._pixels(points)
        cv2.fillPoly(self.rgb, [corners], _tuple(colour), cv2.LINE_AA, 3)
        if material is not None:
            cv2.fillPoly(self.material, [corners], material, cv2.LINE_8, 3)

    def rectangle(
        self, x: float, y: float, width: float, height: float, colour: Any, material: Any = None
    ) -> None:
        """Fill a rectangle by its lower left corner and its size."""
        corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
        self.polygon(corners, colour, material)

    def line(self, points: Any, colour: Any, width: float) -> None:
        """Draw an open chain of segments."""
        import cv2

        thick = max(1, round(width * self.density))
        path = self._pixels(points)
        cv2.polylines(self.rgb, [path], False, _tuple(colour), thick, cv2.LINE_AA, 3)

    def ellipse(
        self, x: float, y: float, rx: float, ry: float, colour: Any, material: Any = None
    ) -> None:
        """Fill an axis-parallel ellipse by its middle and its half axes."""
        import cv2

        middle = tuple(self._pixels((x, y))[0].tolist())
        axes = (round(rx * self.density * 8), round(ry * self.density * 8))
        shape = (middle, axes, 0, 0, 360)
        cv2.ellipse(self.rgb, *shape, _tuple(colour), -1, cv2.LINE_AA, 3)
        if material is not None:
            cv2.ellipse(self.material, *shape, material, -1, cv2.LINE_8, 3)

    def text(self, x: float, y: float, words: str, height: float, colour: Any) -> None:
        """Write from a baseline's left end; capital letters have the height."""
        import cv2

        scale = height * self.density / 21.0
        origin = (round(x * self.density), round((self.size[1] - y) * self.density))
        thick = max(1, round(2.2 * scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(self.rgb, words, origin, font, scale, _tuple(colour), thick, cv2.LINE_AA)

    def mottle(self, generator: np.random.Generator, cell: float, strength: float) -> None:
        """Multiply by smooth noise of a cell size: dirt, wear, uneven colour."""
        factor = 1.0 + strength * blotches(generator, self.rgb.shape[:2], cell * self.density)
        self.rgb[:] = np.clip(self.rgb * factor[..., None], 0, 255)

    def texture(self) -> np.ndarray:
        """(rows, columns, 4) uint8, as :meth:`Atlas.pack` takes it."""
        return np.dstack([self.rgb, self.material])


def blotches(
    generator: np.random.Generator, shape: tuple[int, int], cell: float | int
) -> np.ndarray:
    """Smooth noise (rows, columns) of about unit variance, that changes over a cell of pixels."""
    import cv2

    rows, columns = (max(2, int(np.ceil(side / cell)) + 1) for side in shape)
    noise = generator.standard_normal((rows, columns)).astype(np.float32)
    return cv2.resize(noise, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)


def _tuple(colour: Any) -> tuple[int, int, int]:
    red, green, blue = (int(np.clip(part, 0, 255)) for part in colour)
    return red, green, blue
