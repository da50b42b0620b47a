"""Multilevel refinement of large sparse graphs: node moves, contraction, and subproblems."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from mixer_torch.solvers.compiled import compiled, inner
from mixer_torch.solvers.search.descent import PRECISION
from mixer_torch.solvers.search.graph import Graph, arrays_of, compact
from mixer_torch.solvers.search.greedy import greedy
from mixer_torch.solvers.search.iterated_local_search import STATE_SIZE, new_search_state
from mixer_torch.solvers.search.subproblem import Labelling, search_subproblem

# Set by hand; benchmarks/sensitivity.py shows what half and twice of each do.
SUBPROBLEM = 96  # nodes that may move in one subproblem
SWEEPS = 50  # most sweeps of node moves over all nodes at one level


def refine_large(
    graph: Graph,
    label: np.ndarray,
    restarts: int,
    random: np.ndarray,
    deadline: float,
    progress: Callable[[float], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Better labels of a graph that is too large to hold as a matrix; never worse.

    Two levels alternate until neither gains: nodes move one at a time, and clusters, contracted to
    nodes, join and move as wholes. Then subproblems of about a hundred nodes each, connected by
    negative costs, are searched (:func:`search_subproblem`) until each node was in one. Memory is
    linear in the number of edges.

    Args:
        graph: The problem.
        label: (n,) feasible labels.
        restarts: In each subproblem.
        random: (1,) uint64 state of the random draws, written.
        deadline: Value of ``time.perf_counter()`` after which nothing new begins.
        progress: Called with the fraction of the nodes that were in a subproblem.

    Returns:
        The labels, and the sum of the search states (see :func:`search`).
    """
    label = _levels(graph, compact(label), deadline)
    label, search_state = _subproblems(graph, label, restarts, random, deadline, progress)
    return _levels(graph, compact(label), deadline), search_state


def _levels(graph: Graph, label: np.ndarray, deadline: float) -> np.ndarray:
    """Node moves, then moves and joins of clusters, in turn, until neither gains."""
    members, before = graph.members(), np.inf
    after = graph.objective(label)
    while after < before and time.perf_counter() < deadline:
        before = after
        label = compact(_swept(graph, label, members))
        coarse = graph.contract(label)
        joined = compact(greedy(coarse))
        joined = compact(_swept(coarse, joined, coarse.members()))
        label = joined[label]
        after = graph.objective(label)
    return label


def _swept(graph: Graph, label: np.ndarray, members: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return _sweep(arrays_of(graph), members, Labelling.of(graph, label.copy()), SWEEPS)


def _subproblems(
    graph: Graph,
    label: np.ndarray,
    restarts: int,
    random: np.ndarray,
    deadline: float,
    progress: Callable[[float], None] | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Each node is in one subproblem: seeds in order, each with nodes near it that were in none."""
    arrays, members = arrays_of(graph), graph.members()
    labelling = Labelling.of(graph, label.copy())
    was_in = np.zeros(len(graph), np.bool_)
    done, total = 0, np.zeros(STATE_SIZE)
    for seed in range(len(graph)):
        if was_in[seed]:
            continue
        if time.perf_counter() > deadline:
            break
        nodes = _around(arrays, was_in, seed, SUBPROBLEM)
        state, confirmed = new_search_state(restarts), np.zeros(len(nodes))
        search_subproblem(arrays, members, labelling, nodes, restarts, state, confirmed, random)
        total += state
        done += len(nodes)
        if progress is not None:
            progress(done / len(graph))
    return labelling.label, total


@compiled
def _around(graph, was_in, seed, limit):
    """Nodes near the seed by steps of negative cost, breadth first, that were in no subproblem."""
    start, neighbour, cost, _, _ = graph
    nodes = np.empty(limit, np.int64)
    nodes[0], count, at = seed, 1, 0
    was_in[seed] = True
    while at < count and count < limit:
        a = nodes[at]
        for e in range(start[a], start[a + 1]):
            b = neighbour[e]
            if cost[e] < 0 and not was_in[b] and count < limit:
                was_in[b] = True
                nodes[count] = b
                count += 1
        at += 1
    return nodes[:count].copy()


@compiled
def _sweep(graph, members, labelling, sweeps):
    """Move single nodes to where they cost least, sweep after sweep, until none gains.

    A node is tried again only if a neighbour, or a node that shares a group with it, has moved.
    """
    n = len(labelling.label)
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
                target = _best_label(graph, members, labelling, i, tiny, total, touched, seen)
                if target >= 0:
                    _relabel(labelling, i, target)
                    _wake(graph, members, wake, i)
                    moved += 1
        if moved == 0:
            break
    return labelling.label


@inner
def _best_label(graph, members, labelling, i, tiny, total, touched, seen):
    """Where node i costs least, -1 for where it is; the scratch is left as it was found."""
    start, neighbour, cost, _, _ = graph
    own, count = labelling.label[i], 0
    for e in range(start[i], start[i + 1]):
        c = labelling.label[neighbour[e]]
        if not seen[c]:
            seen[c] = True
            touched[count] = c
            count += 1
        total[c] += cost[e]
    best, target = total[own] - tiny, -1
    if best > 0 and labelling.size[own] > 1:
        best, target = 0.0, labelling.unused[labelling.height[0] - 1]
    for p in range(count):
        c = touched[p]
        if c != own and total[c] < best and _is_open(graph, members, labelling, i, c):
            best, target = total[c], c
    for p in range(count):
        total[touched[p]] = 0.0
        seen[touched[p]] = False
    return target


@inner
def _wake(graph, members, wake, i):
    """The neighbours of node i, and the nodes that share a group with it, are tried again."""
    start, neighbour, _, group_start, group = graph
    for e in range(start[i], start[i + 1]):
        wake[neighbour[e]] = True
    for e in range(group_start[i], group_start[i + 1]):
        for f in range(members[0][group[e]], members[0][group[e] + 1]):
            wake[members[1][f]] = True


@inner
def _is_open(graph, members, labelling, i, c):
    """Whether no node of label c shares a group with node i."""
    _, _, _, group_start, group = graph
    member_start, member = members
    for e in range(group_start[i], group_start[i + 1]):
        for f in range(member_start[group[e]], member_start[group[e] + 1]):
            if labelling.label[member[f]] == c and member[f] != i:
                return False
    return True


@inner
def _relabel(labelling, i, target):
    """Give node i another label, which may be the last unused one."""
    own = labelling.label[i]
    if labelling.size[target] == 0:
        labelling.height[0] -= 1
    labelling.size[own] -= 1
    labelling.size[target] += 1
    labelling.label[i] = target
    if labelling.size[own] == 0:
        labelling.unused[labelling.height[0]] = own
        labelling.height[0] += 1
