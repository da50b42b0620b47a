"""Frames of several cameras as one sequence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


class JoinedFrames(Sequence[np.ndarray]):
    """Sequences of frames, one after the other: all of the first camera, then of the second.

    Args:
        parts: One sequence of (height, width, 3) uint8 RGB frames a camera.
    """

    def __init__(self, parts: Sequence[Any]) -> None:
        self.parts = tuple(parts)
        self.starts = np.cumsum([0, *map(len, self.parts)])

    def __len__(self) -> int:
        return int(self.starts[-1])

    def __getitem__(self, index: Any) -> Any:
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        part = int(np.searchsorted(self.starts, index, side="right")) - 1
        return self.parts[part][index - int(self.starts[part])]
