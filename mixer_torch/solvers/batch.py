"""Several problems as one graph, and what is done to all of their parts at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from mixer_torch.association import Status
from mixer_torch.solvers.gradient.batch import LARGEST_CPU, Batch, buckets
from mixer_torch.solvers.gradient.stage import GradientStage, Relaxed
from mixer_torch.solvers.problem import Problem, Solution
from mixer_torch.solvers.refinement import Effort, refine_parts, summary
from mixer_torch.solvers.search.decomposition import Parts, decompose
from mixer_torch.solvers.search.exhaustive import LARGEST as ENUMERABLE
from mixer_torch.solvers.search.graph import Graph

# Nodes of a part up to which it goes through the gradient stage on a GPU, so that dense matrices
# take little of the memory; on a CPU it is ``LARGEST_CPU``. Set by hand.
LARGEST_GPU = 2000
# Shares of the work for each thread, by convention, since some take longer than others.
SHARES = 4
# Columns of U for each cluster that greedy contraction finds, and some more, which counts in small
# parts: the gradient stage may find more clusters than greedy contraction does. Set by hand.
CLUSTERS, MORE_COLUMNS = 1.5, 2
A = TypeVar("A")
B = TypeVar("B")


@dataclass(frozen=True)
class ProblemBatch:
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
    def of(cls, problems: Sequence[Problem]) -> ProblemBatch:
        """One graph of problems of one dtype on one device; no two share a cannot-link group."""
        start = np.cumsum([0] + [len(problem) for problem in problems])
        graph = Graph.from_problems(problems)
        return cls(graph, decompose(graph), start, problems[0].cost)

    @property
    def owner(self) -> np.ndarray:
        """(n,) the problem of each node."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    def refine(self, label: np.ndarray, effort: Effort) -> tuple[np.ndarray, np.ndarray, bool]:
        """Discrete refinement of all problems, on as many threads as torch uses.

        A problem's labels depend neither on its neighbours nor on the threads.

        Returns:
            Better labels, (parts, STATE_SIZE) the state in which the search of each part ended, and
            whether time ran out.
        """
        threads = torch.get_num_threads()
        borders = self._shares(SHARES * threads if threads > 1 else 1)
        done = np.zeros(len(borders) - 1)  # the fraction of each share
        lock = Lock()
        key = np.arange(len(self.graph)) - self.start[self.owner]

        def search(share: int) -> tuple[np.ndarray, np.ndarray, bool]:
            def tell(fraction: float) -> None:
                with lock:
                    done[share] = fraction
                    if effort.progress is not None:
                        effort.progress(float(done @ np.diff(borders)) / len(self.graph))

            first, end = borders[share : share + 2]
            graph, parts = self._between(first, end)
            own = effort._replace(progress=tell)
            return refine_parts(graph, parts, label[first:end], own, key[first:end])

        found = list(_mapped(search, range(len(done)), threads))
        moved = [own + first for (own, _, _), first in zip(found, borders, strict=False)]
        states = np.concatenate([state for _, state, _ in found])
        return np.concatenate(moved), states, any(late for _, _, late in found)

    def _shares(self, most: int) -> list[int]:
        """Nodes at which the problems are divided into shares of about equal size."""
        wanted = np.arange(1, most) * len(self.graph) / most
        inner = self.start[np.searchsorted(self.start, wanted)]
        return sorted({0, *inner.tolist(), len(self.graph)})

    def _between(self, first: int, end: int) -> tuple[Graph, Parts]:
        """The graph of some consecutive problems and its parts, copied only if need be."""
        if end - first == len(self.graph):
            return self.graph, self.parts
        edges = slice(*self.graph.start[[first, end]])
        groups = slice(*self.graph.group_start[[first, end]])
        group = self.graph.group[groups]
        graph = Graph(
            self.graph.start[first : end + 1] - edges.start,
            self.graph.neighbour[edges] - np.int32(first),
            self.graph.cost[edges],
            self.graph.group_start[first : end + 1] - groups.start,
            group - group.min() if len(group) else group,
        )
        part = self.parts.part[first:end]  # a problem's parts are numbered one after the other
        start = self.parts.start[part.min() : part.max() + 2]
        order = self.parts.order[start[0] : start[-1]] - first
        return graph, Parts(part - part.min(), order, start - start[0])

    def objective(self, label: np.ndarray) -> np.ndarray:
        """(parts,) cost of the pairs inside clusters, each of which lies in one part."""
        return self.graph.objective_by_part(label, self.parts.part, len(self.parts))

    def relax(
        self,
        stage: GradientStage,
        label: np.ndarray,
        deadline: float,
        progress: Callable[[float], None],
    ) -> dict[int, Relaxed]:
        """What the gradient stage makes of each part that is neither trivial nor too large.

        Args:
            stage: The gradient stage.
            label: (n,) labels, whose number of clusters in a part says how many columns U needs.
            deadline: By ``time.perf_counter()``, after which no further batch begins.
            progress: Told the fraction that is done.
        """
        size = np.diff(self.parts.start)
        largest = LARGEST_CPU if self.like.device.type == "cpu" else LARGEST_GPU
        which = np.flatnonzero((size > ENUMERABLE) & (size <= largest))
        first = np.unique(label, return_index=True)[1]
        clusters = np.bincount(self.parts.part[first], minlength=len(size))
        columns = np.minimum(size, np.ceil(CLUSTERS * clusters).astype(np.int64) + MORE_COLUMNS)
        found: dict[int, Relaxed] = {}

        def run(bucket: list[int]) -> dict[int, Relaxed]:
            if time.perf_counter() >= deadline:
                return {}
            chosen = which[bucket]
            batch = Batch.of_parts(self.graph, self.parts, chosen.tolist(), self.like)
            relaxed = stage.run(batch, int(columns[chosen].max()))
            return dict(zip(chosen.tolist(), relaxed, strict=True))

        # a device is kept busy by one batch at a time
        threads = torch.get_num_threads() if self.like.device.type == "cpu" else 1
        for answers in _mapped(run, buckets(size[which].tolist(), self.like.device), threads):
            found.update(answers)
            progress(len(found) / len(which))
        return found

    def labels(self, found: dict[int, Relaxed], otherwise: np.ndarray) -> np.ndarray:
        """The labels of the parts that were found, and other ones for the other parts."""
        label = otherwise + len(self.graph)
        for part, relaxed in found.items():
            nodes = self.parts.order[self.parts.start[part] : self.parts.start[part + 1]]
            own = np.unique(relaxed.labels.numpy(), return_inverse=True)[1]
            label[nodes] = nodes[own]
        return label

    def better(self, label: np.ndarray, other: np.ndarray) -> np.ndarray:
        """In each part the labels with the lower objective; both respect parts."""
        win = self.objective(other) < self.objective(label)
        return np.where(win[self.parts.part], other + len(self.graph), label)

    def solutions(
        self,
        label: np.ndarray,
        relaxed: dict[int, Relaxed],
        stages: dict[str, np.ndarray],
        states: np.ndarray,
        timed_out: bool,
    ) -> list[Solution]:
        """The answer to each problem, and what each stage made of its parts.

        Args:
            label: (n,) the answer.
            relaxed: By part, what the gradient stage found.
            stages: (n,) the labels at the end of each stage, by its name.
            states: (parts, STATE_SIZE) the state in which the search of each part ended.
            timed_out: Whether the time limit ended the search.
        """
        solutions = []
        for b, stats in enumerate(_stats(self, relaxed, stages, states)):
            own = torch.from_numpy(label[self.start[b] : self.start[b + 1]])
            status = Status.CONVERGED if stats["binary_without_rounding"] else Status.ROUNDED
            solutions.append(Solution(Status.TIME_LIMIT if timed_out else status, own, stats=stats))
        return solutions


def _mapped(function: Callable[[A], B], items: Iterable[A], threads: int) -> Iterator[B]:
    """The results in order, on so many threads where there is more than one item."""
    items = list(items)
    if threads == 1 or len(items) == 1:
        yield from map(function, items)
    else:
        with ThreadPoolExecutor(threads) as pool:
            yield from pool.map(function, items)


def _stats(
    batch: ProblemBatch,
    found: dict[int, Relaxed],
    stages: dict[str, np.ndarray],
    states: np.ndarray,
) -> list[dict[str, Any]]:
    """By problem: what the gradient stage and the search made of its parts, added up."""
    home = batch.owner[batch.parts.order[batch.parts.start[:-1]]]
    all_stats = _histories(batch, home, found)
    state = np.zeros((len(all_stats), states.shape[1]))
    np.add.at(state, home, states)
    for name, labels in stages.items():
        value = np.bincount(home, batch.objective(labels), len(all_stats))
        for stats, own in zip(all_stats, value.tolist(), strict=True):
            stats[f"objective_{name}"] = own
    for stats, own in zip(all_stats, state, strict=True):
        stats |= summary(own)
        stats["history"].append(stats["objective_refined"])
    return all_stats


def _histories(
    batch: ProblemBatch, home: np.ndarray, found: dict[int, Relaxed]
) -> list[dict[str, Any]]:
    """Statistics of the gradient stage by problem: of its parts, objectives added up."""
    stats: list[dict[str, Any]] = [
        {"iterations": 0, "binary_without_rounding": True, "penalty": 0.0, "parts": 0, "relaxed": 0}
        for _ in range(len(batch.start) - 1)
    ]
    histories: list[list[np.ndarray]] = [[] for _ in stats]
    for part in range(len(batch.parts)):
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
            total[: len(row)] += row
            total[len(row) :] += row[-1]
        own["history"] = total.tolist()
    return stats
