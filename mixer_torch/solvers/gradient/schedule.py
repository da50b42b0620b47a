"""The extension point of the gradient stage: how the relaxed problem becomes binary."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, get_args

from mixer_torch.solvers.gradient.batch import Batch, Descent


class Schedule(ABC):
    """A descent on the relaxed problem whose weights change until U is binary."""

    @abstractmethod
    def descend(self, batch: Batch, columns: int, max_iterations: int, seed: int) -> Descent:
        """Descend on all problems of a batch.

        Args:
            batch: The problems.
            columns: k, the number of columns of U, at least the number of clusters.
            max_iterations: Steps at most.
            seed: Of all random draws.
        """


def choice(name: str, value: str, allowed: Any) -> None:
    """ValueError, naming the argument, unless the value is one of those of a ``Literal``."""
    if value not in get_args(allowed):
        raise ValueError(f"{name}: expected one of {', '.join(get_args(allowed))}, got {value!r}")
