"""Who is who: the answer, with proof of what was reached."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from mixer_torch.io.files import load_npz, save_npz

FORMAT = "mixer-torch association 1"


class Status(Enum):
    """How a solve ended: the text says what happened and which knob to turn."""

    CONVERGED = "converged to a feasible answer"
    OPTIMAL = "proven to be optimal"
    ROUNDED = (
        "the relaxation was not binary when iterations ran out, and was rounded view by view; "
        "raise max_iterations"
    )
    TIME_LIMIT = "time ran out, this is the best feasible answer so far; raise time_limit"
    INCONSISTENT = (
        "the links do not form consistent clusters, so there are no labels; "
        "use a solver that enforces consistency"
    )


@dataclass(frozen=True)
class Association:
    """A cluster for each observation.

    Args:
        labels: (m,) int64, 0.. in order of first appearance; None where the links of a baseline
            are not consistent.
        objective: Sum of the fused cost over the links. All singletons have 0; lower is better.
        status: How it ended.
        lower_bound: Proven lower bound of the objective, where one was computed.
        stats: iterations, seconds, history, … as the solver tells.
        declared_links: (2, Q) the pairs that are declared the same, where there are no labels.
    """

    labels: Tensor | None
    objective: float
    status: Status
    lower_bound: float | None = None
    stats: Mapping[str, Any] = field(default_factory=dict)
    declared_links: Tensor | None = None

    def __post_init__(self) -> None:
        if (self.labels is None) == (self.declared_links is None):
            raise ValueError("labels, declared_links: expected one of them, got both or neither")

    def __repr__(self) -> str:
        if self.labels is None:
            found, device = f"{self.links.shape[1]} links, no labels", self.links.device
        else:
            found = f"{len(self.labels)} observations in {self.num_clusters} clusters"
            device = self.labels.device
        bound = "" if self.lower_bound is None else f", lower bound {self.lower_bound:.6g}"
        return (
            f"Association({found}; objective {self.objective:.6g}{bound}; "
            f"{self.status.name}; {device})"
        )

    @cached_property
    def links(self) -> Int64[Tensor, "2 Q"]:
        """(2, Q) all pairs that are declared the same, the smaller index first.

        Derived from the labels where there are any, when it is first asked for: there are as many
        as the squares of the clusters' sizes.
        """
        if self.labels is None:
            return self.declared_links  # type: ignore[return-value]
        return links_of(self.labels)

    @property
    def gap(self) -> float | None:
        """(objective - lower_bound) / |objective|: 0 is optimal.

        None where nothing is proven, and where there are no labels: links that are not consistent
        may lie below what no consistent answer can reach.
        """
        if self.lower_bound is None or self.labels is None:
            return None
        distance = max(self.objective - self.lower_bound, 0.0)
        return distance / max(abs(self.objective), 1e-12) if distance > 0 else 0.0

    @property
    def num_clusters(self) -> int | None:
        """How many different objects there are; None where there are no labels."""
        if self.labels is None:
            return None
        return int(self.labels.max()) + 1 if len(self.labels) else 0

    def save(self, path: str | Path) -> None:
        """Write one npz: ``labels`` or ``links``, ``objective``, ``lower_bound`` (NaN for none),
        ``status`` (the name), ``stats`` (JSON).
        """
        bound = np.nan if self.lower_bound is None else self.lower_bound
        arrays: dict[str, Any] = {
            "format": np.array(FORMAT),
            "objective": np.array(self.objective),
            "lower_bound": np.array(bound),
            "status": np.array(self.status.name),
            "stats": np.array(json.dumps(dict(self.stats), default=str)),
        }
        which = "links" if self.labels is None else "labels"
        value = self.links if self.labels is None else self.labels
        save_npz(path, arrays | {which: value.cpu().numpy()})

    @classmethod
    def load(cls, path: str | Path) -> Association:
        """Read what :meth:`save` wrote."""
        arrays = load_npz(path, FORMAT)
        bound = float(arrays["lower_bound"])
        return cls(
            labels=torch.from_numpy(arrays["labels"]) if "labels" in arrays else None,
            objective=float(arrays["objective"]),
            status=Status[str(arrays["status"])],
            lower_bound=None if np.isnan(bound) else bound,
            stats=json.loads(str(arrays["stats"])),
            declared_links=torch.from_numpy(arrays["links"]) if "links" in arrays else None,
        )


def by_first_appearance(labels: Int64[Tensor, " m"]) -> Int64[Tensor, " m"]:
    """The same clusters, numbered 0.. in the order in which they first appear."""
    unique, inverse = torch.unique(labels, return_inverse=True)
    place = torch.arange(len(labels), device=labels.device)
    first = torch.full_like(unique, len(labels)).scatter_reduce(0, inverse, place, "amin")
    rank = torch.empty_like(unique)
    rank[first.argsort()] = torch.arange(len(unique), device=labels.device)
    return rank[inverse]


def links_of(labels: Int64[Tensor, " m"]) -> Int64[Tensor, "2 Q"]:
    """All pairs of one label, in lexicographic order."""
    value, order = torch.sort(labels, stable=True)
    size = torch.unique_consecutive(value, return_counts=True)[1]
    end = torch.repeat_interleave(torch.cumsum(size, 0), size)
    place = torch.arange(len(labels), device=labels.device)
    count = end - place - 1
    first = torch.repeat_interleave(place, count)
    rank = torch.arange(len(first), device=labels.device)
    second = first + 1 + rank - torch.repeat_interleave(torch.cumsum(count, 0) - count, count)
    links = order[torch.stack([first, second])]
    return links[:, (links[0] * max(len(labels), 1) + links[1]).argsort()]
