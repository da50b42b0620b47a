"""Parts of a problem, as graphs of their own."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.problem import Problem
from mixer_torch.solvers.search.graph import Graph


def graph_of(problem: Problem) -> Graph:
    """The graph of a problem, whose nodes may have one view each or sets of views."""
    return Graph.from_arrays(
        len(problem),
        problem.pairs.cpu().numpy(),
        problem.cost.detach().cpu().double().numpy(),
        problem.incidence.cpu().numpy(),
    )


def induced(graph: Graph, members: np.ndarray) -> Graph:
    """What lies between some of the nodes, which are renumbered 0.. in their order."""
    place = np.full(len(graph), -1)
    place[members] = np.arange(len(members))
    edge, owner = _entries(graph.start, members)
    near, far = owner, place[graph.neighbour[edge]]
    once = near < far
    entry, node = _entries(graph.token_start, members)
    return Graph.from_arrays(
        len(members),
        np.stack([near[once], far[once]]),
        graph.cost[edge[once]],
        np.stack([node, graph.token[entry]]),
    )


def _entries(start: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The entries of some rows of a compressed matrix, and whose of the rows each one is."""
    size = start[rows + 1] - start[rows]
    owner = np.repeat(np.arange(len(rows)), size)
    offset = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
    return start[rows][owner] + offset, owner
