"""Decomposition into parts that can be solved independently, without loss."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.search.graph import Graph, compact


class Parts(NamedTuple):
    """Nodes by part: the nodes of part p are ``order[start[p]:start[p + 1]]``."""

    part: np.ndarray  # (n,) int64 part of each node, 0.. in order of first appearance
    order: np.ndarray  # (n,) int64 the nodes, part by part, ascending inside each
    start: np.ndarray  # (parts + 1,) int64

    def __len__(self) -> int:
        """Number of parts."""
        return len(self.start) - 1


def decompose(graph: Graph) -> Parts:
    """Connected components of the pairs with negative cost; each can be solved on its own, exactly.

    Let a clustering have a cluster C with nodes of several components, and cut C along them. Every
    pair that the cut separates lies in two components, so its cost is >= 0 (a pair with negative
    cost connects the two), and a part of a feasible cluster is feasible. So the cost does not rise,
    and some optimal clustering has each cluster inside one component. Between such clusters no
    pair counts, so the optima of the components together are an optimum of the whole.
    """
    part = components(graph, np.zeros(len(graph), np.int64))
    order = np.argsort(part, kind="stable")
    count = np.bincount(part) if len(part) else np.zeros(0, np.int64)
    return Parts(part, order, np.concatenate([[0], np.cumsum(count)]).astype(np.int64))


def cut_along(label: np.ndarray, parts: Parts) -> np.ndarray:
    """The clusters cut along the parts; this never costs more (see :func:`decompose`)."""
    return compact(compact(label) * max(len(parts), 1) + parts.part)


def components(graph: Graph, label: np.ndarray) -> np.ndarray:
    """(n,) int64 components of the pairs with negative cost and one label, by first appearance."""
    return _components(graph.start, graph.neighbour, graph.cost, label)


@compiled
def _components(start, neighbour, cost, label):
    n, parts = len(start) - 1, 0
    part = np.full(n, -1, np.int64)
    stack = np.empty(n, np.int64)
    for seed in range(n):
        if part[seed] >= 0:
            continue
        part[seed], stack[0], waiting = parts, seed, 1
        while waiting > 0:
            waiting -= 1
            a = stack[waiting]
            for e in range(start[a], start[a + 1]):
                b = neighbour[e]
                if cost[e] < 0 and part[b] < 0 and label[a] == label[b]:
                    part[b] = parts
                    stack[waiting] = b
                    waiting += 1
        parts += 1
    return part
