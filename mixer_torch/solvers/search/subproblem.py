"""Subproblems: search among some nodes of a large graph, while all others stay together.

The members of a cluster that are not among these nodes, its remainder, become one node, whose costs
add and whose groups unite. No two remainders join. So any change of the cost of the subproblem is
the same change of the cost of the whole.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.search.graph import Graph
from mixer_torch.solvers.search.iterated_local_search import SETTINGS, search


class Labelling(NamedTuple):
    """Labels of a graph of n nodes, and scratch to change them one subproblem at a time."""

    label: np.ndarray  # (n,) int64 in 0..n-1
    size: np.ndarray  # (n,) nodes of each label
    unused: np.ndarray  # (n,) stack of the labels that no node has
    height: np.ndarray  # (1,) of the stack
    local: (
        np.ndarray
    )  # (n,) number of a node in the subproblem; -1 outside searches, as the next two
    remainder: np.ndarray  # (n,) number of the remainder of a label
    renumbered: np.ndarray  # (T,) number of a group

    @classmethod
    def of(cls, graph: Graph, label: np.ndarray) -> Labelling:
        """For labels in 0..n-1, which are written from here on."""
        n = len(graph)
        size = np.bincount(label, minlength=n).astype(np.int64)
        free = np.flatnonzero(size == 0)
        unused = np.zeros(n, np.int64)
        unused[: len(free)] = free[::-1]
        groups = int(graph.group.max()) + 1 if len(graph.group) else 0
        none = np.full(n, -1, np.int64)
        height = np.array([len(free)])
        return cls(label, size, unused, height, none, none.copy(), np.full(groups, -1, np.int64))


def search_subproblem(
    graph: tuple[np.ndarray, ...],
    members: tuple[np.ndarray, np.ndarray],
    labelling: Labelling,
    nodes: np.ndarray,
    limit: int,
    search_state: np.ndarray,
    confirmed: np.ndarray,
    random: np.ndarray,
) -> bool:
    """Search for better clusters of some nodes.

    Args:
        graph: start, neighbour, cost, group_start, group of the graph.
        members: The nodes of each group, see :meth:`Graph.members`.
        labelling: The labels, written.
        nodes: (k,) the nodes that may move.
        limit: See :func:`search`, as
        search_state: (STATE_SIZE,) and
        confirmed: (k,) of the nodes, both written; and what it returns.
        random: (1,) uint64 state, written.
    """
    weight, group_start, group, local, kept = _cut_out(graph, members, labelling, nodes)
    own = np.full(len(local), np.inf)
    own[: len(nodes)] = confirmed
    ended = search(weight, group_start, group, local, limit, search_state, own, SETTINGS, random)
    confirmed[:] = own[: len(nodes)]
    _put_back(labelling, nodes, kept, local)
    return bool(ended)


@compiled
def _cut_out(graph, members, labelling, nodes):
    """The subproblem as a dense graph: weight, groups, labels, and the labels with remainders."""
    start, neighbour, cost, group_start, group = graph
    free = len(nodes)
    for i in range(free):
        labelling.local[nodes[i]] = i
        labelling.size[labelling.label[nodes[i]]] -= 1
    kept = _remainders(start, neighbour, cost, labelling, nodes)
    k = free + len(kept)
    weight = np.zeros((k, k))
    for i in range(free):
        for e in range(start[nodes[i]], start[nodes[i] + 1]):
            j = labelling.local[neighbour[e]]
            if j < 0 and labelling.remainder[labelling.label[neighbour[e]]] >= 0:
                j = free + labelling.remainder[labelling.label[neighbour[e]]]
                weight[j, i] += cost[e]
            if j >= 0:
                weight[i, j] += cost[e]
    own_start, own = _local_groups(group_start, group, members, labelling, nodes, len(kept))
    _delete_conflicts(weight, own_start, own, free)
    local = _local_labels(labelling, nodes, len(kept))
    for r in range(len(kept)):
        labelling.remainder[kept[r]] = -1
    return weight, own_start, own, local, kept


@compiled
def _local_labels(labelling, nodes, kept):
    """Labels of the nodes and the remainders; labels that no node outside has become unused."""
    free, fresh = len(nodes), 0
    local = np.arange(free + kept)
    emptied = np.empty(free, np.int64)
    for i in range(free):
        c = labelling.label[nodes[i]]
        if labelling.remainder[c] < 0:
            labelling.remainder[c] = kept + fresh
            emptied[fresh] = c
            fresh += 1
        r = labelling.remainder[c]
        local[i] = free + r if r < kept else r - kept
        labelling.local[nodes[i]] = -1
    for p in range(fresh):
        labelling.remainder[emptied[p]] = -1
        labelling.unused[labelling.height[0]] = emptied[p]
        labelling.height[0] += 1
    return local


@compiled
def _put_back(labelling, nodes, kept, local):
    """Write the labels of the subproblem to those of the graph."""
    free = len(nodes)
    name = np.full(len(local) + 1, -1, np.int64)
    for r in range(len(kept)):
        name[local[free + r]] = kept[r]
    for i in range(free):
        c = local[i]
        if name[c] < 0:
            labelling.height[0] -= 1
            name[c] = labelling.unused[labelling.height[0]]
        labelling.label[nodes[i]] = name[c]
        labelling.size[name[c]] += 1


@compiled
def _remainders(start, neighbour, cost, labelling, nodes):
    """The labels with remainders that attract one of the nodes, or had one as a member."""
    found, count = np.empty(2 * len(nodes) + 1, np.int64), 0
    for a in nodes:
        found, count = _note(labelling, labelling.label[a], found, count)
        for e in range(start[a], start[a + 1]):
            if cost[e] < 0 and labelling.local[neighbour[e]] < 0:
                found, count = _note(labelling, labelling.label[neighbour[e]], found, count)
    return found[:count]


@compiled
def _note(labelling, c, found, count):
    """Number the remainder of label c, if it has one without a number; the list and its length."""
    if labelling.size[c] == 0 or labelling.remainder[c] >= 0:
        return found, count
    if count == len(found):
        found = np.concatenate((found, np.empty(count, np.int64)))
    labelling.remainder[c] = count
    found[count] = c
    return found, count + 1


@compiled
def _local_groups(group_start, group, members, labelling, nodes, kept):
    """Groups of the nodes, and which of these each remainder is in.

    All remainders are in one more group, so that no two of them join.
    """
    free = len(nodes)
    local, used = _renumber(group_start, group, labelling, nodes)
    start = np.ones(free + kept + 1, np.int64)
    start[0] = 0
    for i in range(free):
        start[i + 1] = group_start[nodes[i] + 1] - group_start[nodes[i]]
    holder, held, count = _held(members, labelling, local[: used if kept > 0 else 0])
    for p in range(count):
        start[free + holder[p] + 1] += 1
    start = np.cumsum(start)
    own, fill = np.empty(start[-1], np.int32), start[:-1].copy()
    for i in range(free):
        for e in range(group_start[nodes[i]], group_start[nodes[i] + 1]):
            own[fill[i]] = labelling.renumbered[group[e]]
            fill[i] += 1
    for p in range(count):
        own[fill[free + holder[p]]] = held[p]
        fill[free + holder[p]] += 1
    for r in range(free, free + kept):
        own[fill[r]] = used
    for t in range(used):
        labelling.renumbered[local[t]] = -1
    return start, own


@compiled
def _held(members, labelling, groups):
    """Which remainder is in which of the groups: two lists and their length."""
    start, node = members
    holder, held, count = np.empty(16, np.int64), np.empty(16, np.int64), 0
    for t in range(len(groups)):
        for e in range(start[groups[t]], start[groups[t] + 1]):
            r = labelling.remainder[labelling.label[node[e]]]
            if r >= 0 and labelling.local[node[e]] < 0:
                if count == len(held):
                    holder = np.concatenate((holder, np.empty(count, np.int64)))
                    held = np.concatenate((held, np.empty(count, np.int64)))
                holder[count], held[count] = r, t
                count += 1
    return holder, held, count


@compiled
def _renumber(group_start, group, labelling, nodes):
    """Number the groups of the nodes from 0; returns them in that order, and how many there are."""
    total = 0
    for a in nodes:
        total += group_start[a + 1] - group_start[a]
    local, used = np.empty(total, np.int64), 0
    for a in nodes:
        for e in range(group_start[a], group_start[a + 1]):
            if labelling.renumbered[group[e]] < 0:
                labelling.renumbered[group[e]] = used
                local[used] = group[e]
                used += 1
    return local, used


@compiled
def _delete_conflicts(weight, own_start, own, free):
    """Set the costs between a node and a remainder that share a group to 0."""
    k = len(weight)
    groups = 0
    for t in own:
        groups = max(groups, t + 1)
    holds = np.zeros(groups, np.bool_)
    for r in range(free, k):
        for e in range(own_start[r], own_start[r + 1]):
            holds[own[e]] = True
        for i in range(free):
            for e in range(own_start[i], own_start[i + 1]):
                if holds[own[e]]:
                    weight[i, r] = weight[r, i] = 0.0
        for e in range(own_start[r], own_start[r + 1]):
            holds[own[e]] = False
