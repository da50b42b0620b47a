"""Textures of the parking lot: an atlas with coarser levels, and a canvas measured in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

HOLE, MATTE, PAINT, GLASS, CHROME = 0, 40, 104, 131, 244  # gloss; holes only in foliage
LEVELS = 4


@dataclass(frozen=True)
class Atlas:
    """Textures of any sizes, one after another, each with LEVELS levels of half the size.

    Args:
        table: (tiles, LEVELS, 3) int64: first texel, rows and columns.
        texels: (n, 4) uint8: RGB (255 times the square root of linear light) and gloss.
    """

    table: np.ndarray
    texels: np.ndarray

    @classmethod
    def pack(cls, textures: Sequence[np.ndarray]) -> Atlas:
        """Textures, each (rows, columns, 4) uint8 RGB and gloss, in the order of their tiles."""
        table, parts, first = [], [], 0
        for texture in textures:
            for level in range(LEVELS):
                rows, columns = (max(2, side >> level) for side in texture.shape[:2])
                part = cv2.resize(texture, (columns, rows), interpolation=cv2.INTER_AREA)
                parts.append(part.reshape(-1, 4))
                table.append((first, rows, columns))
                first += rows * columns
        return cls(np.array(table, np.int64).reshape(-1, LEVELS, 3), np.concatenate(parts))


class Canvas:
    """A texture to draw on in metres, with the origin at the lower left.

    Args:
        width: Metres.
        height: Metres.
        colour: RGB of the blank canvas.
        gloss: Of the blank canvas, and of what is drawn without saying.
        density: Pixels a metre.

    Attributes:
        texture: (rows, columns, 4) uint8 RGB and gloss, as :meth:`Atlas.pack` takes it.
    """

    def __init__(
        self, width: float, height: float, colour: Any, gloss: int = PAINT, density: float = 110
    ) -> None:
        self.size, self.gloss, self.density = (width, height), gloss, density
        shape = (round(height * density), round(width * density), 4)
        self.texture = np.full(shape, self._ink(colour), np.uint8)

    def _ink(self, colour: Any, gloss: int | None = None) -> list[int]:
        inks = (*colour, self.gloss if gloss is None else gloss)
        return [int(min(max(ink, 0), 255)) for ink in inks]

    def _pixels(self, points: Any) -> np.ndarray:
        """Eighths of pixels (OpenCV's shift of 3) of (n, 2) metres."""
        points = np.asarray(points, float).reshape(-1, 2)
        flipped = np.stack([points[:, 0], self.size[1] - points[:, 1]], axis=1)
        return np.rint(flipped * self.density * 8).astype(np.int32)

    def polygon(self, points: Any, colour: Any, gloss: int | None = None) -> None:
        """Fill a polygon of (n, 2) metres."""
        cv2.fillPoly(self.texture, [self._pixels(points)], self._ink(colour, gloss), cv2.LINE_AA, 3)

    def rectangle(
        self, x: float, y: float, width: float, height: float, colour: Any, gloss: Any = None
    ) -> None:
        """Fill a rectangle by its lower left corner and its size."""
        corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
        self.polygon(corners, colour, gloss)

    def line(self, points: Any, colour: Any, width: float) -> None:
        """Draw an open chain of segments."""
        thick = max(1, round(width * self.density))
        path = [self._pixels(points)]
        cv2.polylines(self.texture, path, False, self._ink(colour), thick, cv2.LINE_AA, 3)

    def ellipse(
        self, x: float, y: float, rx: float, ry: float, colour: Any, gloss: Any = None
    ) -> None:
        """Fill an axis-parallel ellipse by its middle and its half axes."""
        middle = self._pixels((x, y))[0].tolist()
        axes = (round(rx * self.density * 8), round(ry * self.density * 8))
        ink = self._ink(colour, gloss)
        cv2.ellipse(self.texture, middle, axes, 0, 0, 360, ink, -1, cv2.LINE_AA, 3)

    def text(self, x: float, y: float, words: str, height: float, colour: Any) -> None:
        """Write from a baseline's left end; capital letters have the height."""
        scale = height * self.density / 21.0  # the font's capitals are 21 pixels high
        origin = (self._pixels((x, y))[0] // 8).tolist()
        thick = max(1, round(2.2 * scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(self.texture, words, origin, font, scale, self._ink(colour), thick, cv2.LINE_AA)

    def mottle(self, generator: np.random.Generator, cell: float, strength: float) -> None:
        """Multiply by smooth noise of a cell size: dirt, wear, uneven colour."""
        rgb = self.texture[..., :3]
        factor = 1.0 + strength * smooth_noise(generator, rgb.shape[:2], cell * self.density)
        rgb[:] = np.clip(rgb * factor[..., None], 0, 255)


def smooth_noise(generator: np.random.Generator, shape: tuple[int, int], cell: float) -> np.ndarray:
    """Noise (rows, columns) of about unit variance that changes over a cell of pixels."""
    rows, columns = (max(2, int(np.ceil(side / cell)) + 1) for side in shape)
    noise = generator.standard_normal((rows, columns), dtype=np.float32)
    return cv2.resize(noise, shape[::-1], interpolation=cv2.INTER_CUBIC)
