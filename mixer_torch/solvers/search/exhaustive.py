"""Small parts to the optimum, by dynamic programming over their subsets."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.compiled import compiled, inner
from mixer_torch.solvers.search.decomposition import Parts
from mixer_torch.solvers.search.graph import Graph, arrays_of, share_group

LARGEST = 12  # nodes: 2.7e5 steps, about a millisecond; each further node triples the work


def enumerate_parts(graph: Graph, parts: Parts, label: np.ndarray) -> np.ndarray:
    """Write the optimal labels of all parts of at most 12 nodes; a cluster is named by a member.

    The clusters of a set S of nodes are the one that holds its last node, and the best clusters of
    the rest:

        best(S) = min { cost(T) + best(S - T) : T part of S, last node of S in T }

    where cost(T) is infinite if two of T share a group. n nodes take 3^n / 2 steps. A part whose
    clusters hold all of its negative costs, and no others, is optimal already and left as it is.

    Args:
        graph: The problem.
        parts: Its parts.
        label: (n,) feasible labels, each within one part, written.

    Returns:
        (parts,) the change of the cost of each.
    """
    size = np.diff(parts.start)
    chosen = np.flatnonzero((size > 1) & (size <= LARGEST))
    changed = np.zeros(len(parts))
    if len(chosen):
        _enumerate(arrays_of(graph), *parts, chosen, label, changed)
    return changed


@compiled
def _enumerate(graph, part, order, part_start, chosen, label, changed):
    start, neighbour, cost, group_start, group = graph
    place = np.empty(len(part), np.int64)
    weight = np.empty((LARGEST, LARGEST))
    inside, best = np.empty(2**LARGEST), np.empty(2**LARGEST)
    cluster = np.empty(2**LARGEST, np.int64)
    for p in chosen:
        nodes = order[part_start[p] : part_start[p + 1]]
        for i in range(len(nodes)):
            place[nodes[i]] = i
            for j in range(i):
                conflict = share_group(group_start, group, nodes[i], nodes[j])
                weight[i, j] = np.inf if conflict else 0.0
        before, lowest = 0.0, 0.0
        for a in nodes:
            for e in range(start[a], start[a + 1]):
                b = neighbour[e]
                if b < a and part[b] == p:
                    weight[place[a], place[b]] = cost[e]
                    before += cost[e] if label[a] == label[b] else 0.0
                    lowest += min(cost[e], 0.0)
        if before <= lowest:
            continue
        _solve_subsets(weight, len(nodes), inside, best, cluster)
        whole = 2 ** len(nodes) - 1
        if best[whole] < before:
            changed[p] = best[whole] - before
            _name(nodes, whole, cluster, label)


@inner
def _solve_subsets(weight, n, inside, best, cluster):
    """For each set, as bits: its cost as one cluster, the least cost, its last node's cluster."""
    inside[0] = best[0] = 0.0
    cluster[0] = 0
    for last in range(n):
        top = 1 << last
        for rest in range(top):
            total = inside[rest]
            for j in range(last):
                if rest >> j & 1:
                    total += weight[last, j]
            inside[top + rest] = total
        for rest in range(top):
            least, chosen = best[rest], 0
            with_last = rest
            while with_last > 0:
                value = inside[top + with_last] + best[rest - with_last]
                if value < least:
                    least, chosen = value, with_last
                with_last = (with_last - 1) & rest
            best[top + rest], cluster[top + rest] = least, top + chosen


@inner
def _name(nodes, whole, cluster, label):
    """Label the nodes by the first member of their cluster."""
    left = whole
    while left > 0:
        chosen = cluster[left]
        first = 0
        while not chosen >> first & 1:
            first += 1
        for i in range(first, len(nodes)):
            if chosen >> i & 1:
                label[nodes[i]] = nodes[first]
        left -= chosen
