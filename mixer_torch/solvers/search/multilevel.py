"""Refinement of large sparse graphs: sweeps of single nodes, joins of clusters, local regions."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from mixer_torch.solvers.compiled import compiled, inner
from mixer_torch.solvers.search.graph import Graph, arrays_of, compact
from mixer_torch.solvers.search.greedy import greedy
from mixer_torch.solvers.search.search import COURSE, PRECISION, new_course
from mixer_torch.solvers.search.subproblem import carriers_of, named, search_region

REGION = 96  # nodes that are free to move in one region
SWEEPS = 50  # most sweeps over all nodes in one go


def refine_large(
    graph: Graph,
    label: np.ndarray,
    restarts: int,
    random: np.ndarray,
    deadline: float,
    progress: Callable[[float], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Better labels of a graph that is too large to hold as a matrix; never worse.

    Two levels take turns until neither gains: nodes move one at a time, and clusters, contracted
    to nodes, join and move as wholes. Then regions of about a hundred nodes each, connected by
    negative costs, are searched (:func:`search_region`) until all nodes had their turn. Memory is
    linear in the number of edges.

    Args:
        graph: The problem.
        label: (n,) feasible labels.
        restarts: In each region.
        random: (1,) uint64 state of the random draws, written.
        deadline: Value of ``time.perf_counter()`` after which nothing new begins.
        progress: Told the fraction of the nodes that had their turn.

    Returns:
        The labels, and the courses of the searches, added up (see :func:`search`).
    """
    label = _levels(graph, compact(label), deadline)
    label, course = _regions(graph, label, restarts, random, deadline, progress)
    return _levels(graph, compact(label), deadline), course


def _levels(graph: Graph, label: np.ndarray, deadline: float) -> np.ndarray:
    carrier, before = carriers_of(graph), np.inf
    after = graph.objective(label)
    while after < before and time.perf_counter() < deadline:
        before = after
        label = compact(_swept(graph, label, carrier))
        coarse = graph.contract(label)
        joined = compact(greedy(coarse))
        joined = compact(_swept(coarse, joined, carriers_of(coarse)))
        label = joined[label]
        after = graph.objective(label)
    return label


def _swept(graph: Graph, label: np.ndarray, carrier: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return _sweep(arrays_of(graph), carrier, named(graph, label.copy()), SWEEPS)


def _regions(
    graph: Graph,
    label: np.ndarray,
    restarts: int,
    random: np.ndarray,
    deadline: float,
    progress: Callable[[float], None] | None,
) -> tuple[np.ndarray, np.ndarray]:
    """One turn for every node: seeds in order, each with those around it that had none yet."""
    arrays, carrier, names = arrays_of(graph), carriers_of(graph), named(graph, label.copy())
    had_turn = np.zeros(len(graph), np.bool_)
    done, total = 0, np.zeros(COURSE)
    for seed in range(len(graph)):
        if had_turn[seed]:
            continue
        if time.perf_counter() > deadline:
            break
        nodes = _around(arrays, had_turn, seed, REGION)
        course = new_course(restarts)
        credit = np.zeros(len(nodes))
        search_region(arrays, carrier, names, nodes, restarts, course, credit, random)
        total += course
        done += len(nodes)
        if progress is not None:
            progress(done / len(graph))
    return names.label, total


@compiled
def _around(graph, had_turn, seed, limit):  # type: ignore[no-untyped-def]
    """Nodes near the seed by steps of negative cost, breadth first, that had no turn yet."""
    start, neighbour, cost, _, _ = graph
    nodes = np.empty(limit, np.int64)
    nodes[0], count, at = seed, 1, 0
    had_turn[seed] = True
    while at < count and count < limit:
        a = nodes[at]
        for e in range(start[a], start[a + 1]):
            b = neighbour[e]
            if cost[e] < 0 and not had_turn[b] and count < limit:
                had_turn[b] = True
                nodes[count] = b
                count += 1
        at += 1
    return nodes[:count].copy()


@compiled
def _sweep(graph, carrier, names, sweeps):  # type: ignore[no-untyped-def]
    """Move single nodes to where they cost least, sweep after sweep, until none gains.

    A node is looked at again only if a neighbour, or a carrier of one of its tokens, has moved.
    """
    n = len(names.label)
    total, seen = np.zeros(n), np.zeros(n, np.bool_)
    touched, wake = np.empty(n, np.int64), np.ones(n, np.bool_)
    tiny = 0.0
    for value in graph[2]:
        tiny = max(tiny, PRECISION * abs(value))
    for _ in range(sweeps):
        moved = 0
        for i in range(n):
            if wake[i]:
                wake[i] = False
                target = _best_label(graph, carrier, names, i, tiny, total, touched, seen)
                if target >= 0:
                    _rename(names, i, target)
                    _wake(graph, carrier, wake, i)
                    moved += 1
        if moved == 0:
            break
    return names.label


@inner
def _best_label(graph, carrier, names, i, tiny, total, touched, seen):  # type: ignore[no-untyped-def]
    """Where node i costs least, -1 for where it is; the scratch is left as it was found."""
    start, neighbour, cost, _, _ = graph
    own, count = names.label[i], 0
    for e in range(start[i], start[i + 1]):
        c = names.label[neighbour[e]]
        if not seen[c]:
            seen[c] = True
            touched[count] = c
            count += 1
        total[c] += cost[e]
    best, target = total[own] - tiny, -1
    if best > 0 and names.size[own] > 1:
        best, target = 0.0, names.unused[names.height[0] - 1]
    for p in range(count):
        c = touched[p]
        if c != own and total[c] < best and _is_open(graph, carrier, names, i, c):
            best, target = total[c], c
    for p in range(count):
        total[touched[p]] = 0.0
        seen[touched[p]] = False
    return target


@inner
def _wake(graph, carrier, wake, i):  # type: ignore[no-untyped-def]
    start, neighbour, _, token_start, token = graph
    for e in range(start[i], start[i + 1]):
        wake[neighbour[e]] = True
    for e in range(token_start[i], token_start[i + 1]):
        for f in range(carrier[0][token[e]], carrier[0][token[e] + 1]):
            wake[carrier[1][f]] = True


@inner
def _is_open(graph, carrier, names, i, c):  # type: ignore[no-untyped-def]
    _, _, _, token_start, token = graph
    carrier_start, carrier_node = carrier
    for e in range(token_start[i], token_start[i + 1]):
        for f in range(carrier_start[token[e]], carrier_start[token[e] + 1]):
            if names.label[carrier_node[f]] == c and carrier_node[f] != i:
                return False
    return True


@inner
def _rename(names, i, target):  # type: ignore[no-untyped-def]
    own = names.label[i]
    if names.size[target] == 0:
        names.height[0] -= 1
    names.size[own] -= 1
    names.size[target] += 1
    names.label[i] = target
    if names.size[own] == 0:
        names.unused[names.height[0]] = own
        names.height[0] += 1
