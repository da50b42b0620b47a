"""A certificate on demand: a proven lower bound, also where proving the optimum is out of reach."""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order

from mixer_torch.affinity import Affinity
from mixer_torch.fusion import Fusion
from mixer_torch.solvers.problem import Problem, problem_of
from mixer_torch.solvers.proof.branching import dense
from mixer_torch.solvers.proof.dual_ascent import ascend
from mixer_torch.solvers.search.decomposition import decompose
from mixer_torch.solvers.search.graph import Graph

BLOCK = 1000  # nodes whose pairs are held as a full matrix


def lower_bound(
    problem: Problem | Affinity, *, time_limit: float = 50.0, fusion: Fusion | None = None
) -> float:
    """A number that no clustering's objective is below.

    Each connected component of the negative costs is bounded by dual ascent on 2-partition
    inequalities (:func:`~mixer_torch.solvers.proof.dual_ascent.ascend`), which triangle
    inequalities and the assignments between a node and a view are cases of. A component of more
    than 1000 nodes is split into blocks of neighbours, and the negative costs between blocks are
    added as they are: valid, but only good where few pairs lie between.

    Args:
        problem: The problem, or the affinity that poses it.
        time_limit: Seconds. The longer the tighter, until nothing is gained any more. With the
            default, solving and bounding 500 observations takes less than a minute.
        fusion: How modalities add up, where an affinity is given.

    Raises:
        ValueError: The time limit is negative.
    """
    if not time_limit >= 0:
        raise ValueError(f"time_limit: expected seconds >= 0, got {time_limit}")
    problem = problem_of(problem, fusion) if isinstance(problem, Affinity) else problem
    deadline = time.perf_counter() + time_limit
    graph = Graph.from_problem(problem)
    parts = decompose(graph)
    members = np.split(parts.order, parts.start[1:-1])
    return bound_of_parts([graph.subgraph(own) for own in members if len(own) > 1], deadline)


def bound_of_parts(parts: Iterable[Graph], deadline: float) -> float:
    """Lower bound of several parts together; those of more than BLOCK nodes are split."""
    blocks, total = [], 0.0
    for part in parts:
        pieces, between = split(part, BLOCK)
        blocks += pieces
        total += between
    work = np.array([float(len(block)) ** 2 for block in blocks])
    for i, block in sorted(enumerate(blocks), key=lambda item: len(item[1])):
        left = max(deadline - time.perf_counter(), 0.0)
        share = left * work[i] / work[work >= work[i]].sum()
        work[i] = 0.0 if share == 0 else work[i]
        total += bound_of(block, time.perf_counter() + share)
    return total


def bound_of(graph: Graph, deadline: float) -> float:
    """Lower bound of one part by dual ascent."""
    cost, conflict = dense(graph)
    scale = float(np.abs(cost).max())
    return ascend(cost / scale, conflict, deadline).bound * scale if scale else 0.0


def split(graph: Graph, size: int) -> tuple[list[Graph], float]:
    """Blocks of neighbouring nodes, and the sum of the negative costs between blocks."""
    n = len(graph)
    if n <= size:
        return [graph], 0.0
    attracts = csr_array((graph.cost < 0, graph.neighbour, graph.start), shape=(n, n), copy=True)
    attracts.eliminate_zeros()
    order = breadth_first_order(attracts, 0, return_predecessors=False)
    block = np.empty(n, np.int64)
    block[order] = np.arange(n) * (-(-n // size)) // n
    between = (block[graph.near] != block[graph.neighbour]) & (graph.near < graph.neighbour)
    outside = float(np.minimum(graph.cost[between], 0).sum())
    pieces = [graph.subgraph(np.flatnonzero(block == b)) for b in range(int(block.max()) + 1)]
    return pieces, outside
