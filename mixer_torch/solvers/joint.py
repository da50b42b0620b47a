"""Several problems side by side, solved part by part from two starts."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
import torch
from torch import Tensor

from mixer_torch.association import Status
from mixer_torch.solvers.base import Problem, Solution
from mixer_torch.solvers.gradient.batch import Batch, buckets
from mixer_torch.solvers.gradient.stage import GradientStage, Relaxed
from mixer_torch.solvers.moves.decomposition import Parts, cut_along, decompose, part_costs
from mixer_torch.solvers.moves.graph import Graph, compact
from mixer_torch.solvers.moves.greedy import greedy
from mixer_torch.solvers.refinement import refine

# nodes of a part for the gradient stage; on a CPU, torch leaves matrices of that size to one thread
LARGEST_CPU = 180
LARGEST_GPU = 2000
CLUSTERS = 1.5  # columns of U for each cluster that greedy contraction finds


class Clock:
    """Time that is left of a limit."""

    def __init__(self, limit: float | None) -> None:
        self.end = math.inf if limit is None else time.perf_counter() + limit

    def is_over(self) -> bool:
        """Whether there is none left."""
        return time.perf_counter() >= self.end

    def left(self) -> float | None:
        """Seconds left, at least 0; None if there is no limit."""
        return None if self.end == math.inf else max(self.end - time.perf_counter(), 0.0)


@dataclass(frozen=True)
class Joint:
    """Problems as one graph without edges between them, and its parts.

    Args:
        graph: Of all nodes, problem after problem.
        parts: Its connected components of negative pairs: each lies in one problem.
        start: (B + 1,) nodes of problem b are ``start[b]`` to ``start[b + 1] - 1``.
        like: A tensor of the dtype and on the device of the problems.
    """

    graph: Graph
    parts: Parts
    start: np.ndarray
    like: Tensor

    @classmethod
    def of(cls, problems: Sequence[Problem]) -> Joint:
        """Side by side, with tokens that differ from one problem to the other."""
        start = np.cumsum([0] + [len(problem) for problem in problems])
        graph = Graph.from_problems(problems)
        return cls(graph, decompose(graph), start, problems[0].cost)

    @property
    def owner(self) -> np.ndarray:
        """(n,) the problem of each node."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    def refine(
        self,
        label: np.ndarray,
        restarts: int,
        seed: int,
        time_limit: float | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> tuple[np.ndarray, bool]:
        """Discrete refinement of all problems, on as many threads as torch uses.

        A problem's labels depend neither on its neighbours nor on the threads.

        Returns:
            Better labels, and whether time ran out.
        """
        borders = self._shares(torch.get_num_threads())
        told = np.zeros(len(borders) - 1)
        lock = Lock()

        def search(share: int) -> tuple[np.ndarray, dict[str, Any]]:
            def tell(fraction: float) -> None:
                with lock:
                    told[share] = fraction
                    if progress is not None:
                        progress(float(told @ np.diff(borders)) / len(self.graph))

            first, end = borders[share : share + 2]
            return refine(
                self._between(first, end),
                compact(label[first:end]),
                restarts=restarts,
                seed=seed,
                key=(np.arange(len(self.graph)) - self.start[self.owner])[first:end],
                time_limit=time_limit,
                progress=tell,
            )

        if len(told) == 1:
            found = [search(0)]
        else:
            with ThreadPoolExecutor(len(told)) as pool:
                found = list(pool.map(search, range(len(told))))
        moved = [own + first for (own, _), first in zip(found, borders, strict=False)]
        return np.concatenate(moved), any(stats["timed_out"] for _, stats in found)

    def _shares(self, most: int) -> list[int]:
        """Nodes at which the problems are divided into shares of about equal size."""
        wanted = np.arange(1, most) * len(self.graph) / most
        inner = self.start[np.searchsorted(self.start, wanted)]
        return sorted({0, *inner.tolist(), len(self.graph)})

    def _between(self, first: int, end: int) -> Graph:
        """The graph of some consecutive problems, without a copy where there is none to make."""
        if end - first == len(self.graph):
            return self.graph
        edges = slice(*self.graph.start[[first, end]])
        tokens = slice(*self.graph.token_start[[first, end]])
        token = self.graph.token[tokens]
        return Graph(
            self.graph.start[first : end + 1] - edges.start,
            self.graph.neighbour[edges] - np.int32(first),
            self.graph.cost[edges],
            self.graph.token_start[first : end + 1] - tokens.start,
            token - token.min() if len(token) else token,
        )

    def objective(self, label: np.ndarray) -> np.ndarray:
        """(parts,) cost of the pairs inside clusters, each of which lies in one part."""
        return part_costs(self.graph, label, self.parts.part, len(self.parts))

    def relax(
        self,
        stage: GradientStage,
        label: np.ndarray,
        clock: Clock,
        progress: Callable[[float], None],
    ) -> dict[int, Relaxed]:
        """What the gradient stage makes of each part that is neither trivial nor too large."""
        size = np.diff(self.parts.start)
        largest = LARGEST_CPU if self.like.device.type == "cpu" else LARGEST_GPU
        which = np.flatnonzero((size > 2) & (size <= largest))
        first = np.unique(label, return_index=True)[1]
        clusters = np.bincount(self.parts.part[first], minlength=len(size))
        columns = np.minimum(size, np.ceil(CLUSTERS * clusters).astype(np.int64) + 2)
        found: dict[int, Relaxed] = {}
        for bucket in buckets(size[which].tolist(), self.like.device):
            if clock.is_over():
                break
            chosen = which[bucket]
            batch = Batch.of_parts(self.graph, self.parts, chosen.tolist(), self.like)
            relaxed = stage.run(batch, int(columns[chosen].max()))
            found.update(zip(chosen.tolist(), relaxed, strict=True))
            progress(len(found) / len(which))
        return found

    def labels(self, found: dict[int, Relaxed], otherwise: np.ndarray) -> np.ndarray:
        """The labels of the parts that were found, and other ones for the other parts."""
        label = otherwise + len(self.graph)
        for part, relaxed in found.items():
            nodes = self.parts.order[self.parts.start[part] : self.parts.start[part + 1]]
            own = np.unique(relaxed.labels.cpu().numpy(), return_inverse=True)[1]
            label[nodes] = nodes[own]
        return label

    def better(self, label: np.ndarray, other: np.ndarray) -> np.ndarray:
        """In each part the labels with the lower objective; both respect parts."""
        win = self.objective(other) < self.objective(label)
        return np.where(win[self.parts.part], other + len(self.graph), label)


def solve_side_by_side(
    problems: Sequence[Problem],
    stage: GradientStage,
    restarts: int,
    seed: int,
    clock: Clock,
    progress: Callable[[float], None],
) -> list[Solution]:
    """Problems of one dtype on one device: two starts for each part, restarts from the better.

    One start is greedy contraction, the other is the gradient stage's answer. The result of each
    part is never worse than either.
    """
    joint = Joint.of(problems)
    contracted = cut_along(greedy(joint.graph), joint.parts)
    found = joint.relax(stage, contracted, clock, lambda part: progress(0.3 * part))
    relaxed = joint.labels(found, contracted)
    label = joint.better(contracted, relaxed)
    label, timed_out = joint.refine(
        label, restarts, seed, clock.left(), lambda part: progress(0.3 + 0.7 * part)
    )
    progress(1.0)
    stages = {"greedy": contracted, "gradient": relaxed, "refined": label}
    home = joint.owner[joint.parts.order[joint.parts.start[:-1]]]
    value = {
        name: np.bincount(home, joint.objective(labels), len(problems))
        for name, labels in stages.items()
    }
    histories = _histories(joint, found)
    solutions = []
    for b, problem in enumerate(problems):
        own = label[joint.start[b] : joint.start[b + 1]]
        stats = histories[b] | {f"objective_{name}": float(value[name][b]) for name in stages}
        stats["history"] = [*stats["history"], stats["objective_refined"]]
        status = Status.CONVERGED if stats["binary_without_rounding"] else Status.ROUNDED
        solutions.append(
            Solution(
                Status.TIME_LIMIT if timed_out else status,
                torch.from_numpy(own).to(problem.view.device),
                stats=stats,
            )
        )
    return solutions


def _histories(joint: Joint, found: dict[int, Relaxed]) -> list[dict[str, Any]]:
    """Statistics of the gradient stage by problem: of its parts, objectives added up."""
    size = np.diff(joint.parts.start)
    home = joint.owner[joint.parts.order[joint.parts.start[:-1]]]
    stats: list[dict[str, Any]] = [
        {"iterations": 0, "binary_without_rounding": True, "penalty": 0.0, "parts": 0, "relaxed": 0}
        for _ in range(len(joint.start) - 1)
    ]
    histories: list[list[np.ndarray]] = [[] for _ in stats]
    for part in range(len(size)):
        own = stats[home[part]]
        own["parts"] += 1
        if part in found:
            relaxed = found[part]
            own["relaxed"] += 1
            own["iterations"] = max(own["iterations"], relaxed.iterations)
            own["binary_without_rounding"] &= relaxed.binary
            own["penalty"] = max(own["penalty"], relaxed.penalty)
            histories[home[part]].append(np.array(relaxed.history))
    for own, rows in zip(stats, histories, strict=True):
        longest = max((len(row) for row in rows), default=0)
        total = np.zeros(longest)
        for row in rows:
            total += np.pad(row, (0, longest - len(row)), mode="edge")
        own["history"] = total.tolist()
    return stats
