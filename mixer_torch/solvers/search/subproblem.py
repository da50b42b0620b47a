"""Search among some nodes of a large graph, while all of the others stay together as they are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.search.graph import Graph
from mixer_torch.solvers.search.search import carriers, search


class Names(NamedTuple):
    """Labels of a graph of n nodes with what it takes to change them a region at a time.

    Args:
        label: (n,) int64 in 0..n-1.
        size: (n,) nodes of each label.
        unused: (n,) stack of the labels that no node has.
        height: (1,) of the stack.
        local: (n,) scratch, -1 everywhere between searches: local number of a node,
        remainder: (n,) of the nodes of a label that stay together,
        renumbered: (T,) and of a token.
    """

    label: np.ndarray
    size: np.ndarray
    unused: np.ndarray
    height: np.ndarray
    local: np.ndarray
    remainder: np.ndarray
    renumbered: np.ndarray


def named(graph: Graph, label: np.ndarray) -> Names:
    """The bookkeeping for labels in 0..n-1, which are written from here on."""
    n = len(graph)
    size = np.bincount(label, minlength=n).astype(np.int64)
    free = np.flatnonzero(size == 0)
    unused = np.zeros(n, np.int64)
    unused[: len(free)] = free[::-1]
    tokens = int(graph.token.max()) + 1 if len(graph.token) else 0
    return Names(
        label,
        size,
        unused,
        np.array([len(free)]),
        np.full(n, -1, np.int64),
        np.full(n, -1, np.int64),
        np.full(tokens, -1, np.int64),
    )


def carriers_of(graph: Graph) -> tuple[np.ndarray, np.ndarray]:
    """CSR of the nodes that carry each token."""
    return carriers(graph.token_start, graph.token)


def search_region(
    graph: tuple[np.ndarray, ...],
    carrier: tuple[np.ndarray, np.ndarray],
    names: Names,
    nodes: np.ndarray,
    limit: int,
    course: np.ndarray,
    credit: np.ndarray,
    random: np.ndarray,
) -> bool:
    """Search for better places of some nodes.

    The members of a cluster that are not among them stay together as one node, whose costs add and
    whose tokens unite; no two of these remainders join. So any change of the cost here is the same
    change of the cost of the whole.

    Args:
        graph: start, neighbour, cost, token_start, token of the graph.
        carrier: start and nodes of the CSR of the nodes that carry each token.
        names: The labels, written.
        nodes: (k,) the nodes that are free to move.
        limit: See :func:`search`, as
        course: (COURSE,) and
        credit: (k,) of the nodes, both written; and what it returns.
        random: (1,) uint64 state, written.
    """
    weight, token_start, token, local, kept = _cut_out(graph, carrier, names, nodes)
    own = np.full(len(local), np.inf)
    own[: len(nodes)] = credit
    ended = search(weight, token_start, token, local, limit, course, own, random)
    credit[:] = own[: len(nodes)]
    _put_back(names, nodes, kept, local)
    return bool(ended)


@compiled
def _cut_out(graph, carrier, names, nodes):  # type: ignore[no-untyped-def]
    """The region as a dense graph: weight, token lists, labels, and which remainders it has."""
    start, neighbour, cost, token_start, token = graph
    free = len(nodes)
    for i in range(free):
        names.local[nodes[i]] = i
        names.size[names.label[nodes[i]]] -= 1
    kept = _remainders(start, neighbour, cost, names, nodes)
    k = free + len(kept)
    weight = np.zeros((k, k))
    for i in range(free):
        for e in range(start[nodes[i]], start[nodes[i] + 1]):
            j = names.local[neighbour[e]]
            if j < 0 and names.remainder[names.label[neighbour[e]]] >= 0:
                j = free + names.remainder[names.label[neighbour[e]]]
                weight[j, i] += cost[e]
            if j >= 0:
                weight[i, j] += cost[e]
    own_start, own = _tokens(token_start, token, carrier, names, nodes, len(kept))
    _forget_conflicts(weight, own_start, own, free)
    local = _local_labels(names, nodes, len(kept))
    for r in range(len(kept)):
        names.remainder[kept[r]] = -1
    return weight, own_start, own, local, kept


@compiled
def _local_labels(names, nodes, kept):  # type: ignore[no-untyped-def]
    """Labels of the nodes and the remainders; labels that go out of use are stacked."""
    free, fresh = len(nodes), 0
    local = np.arange(free + kept)
    emptied = np.empty(free, np.int64)
    for i in range(free):
        c = names.label[nodes[i]]
        if names.remainder[c] < 0:
            names.remainder[c] = kept + fresh
            emptied[fresh] = c
            fresh += 1
        r = names.remainder[c]
        local[i] = free + r if r < kept else r - kept
        names.local[nodes[i]] = -1
    for p in range(fresh):
        names.remainder[emptied[p]] = -1
        names.unused[names.height[0]] = emptied[p]
        names.height[0] += 1
    return local


@compiled
def _put_back(names, nodes, kept, local):  # type: ignore[no-untyped-def]
    free = len(nodes)
    name = np.full(len(local) + 1, -1, np.int64)
    for r in range(len(kept)):
        name[local[free + r]] = kept[r]
    for i in range(free):
        c = local[i]
        if name[c] < 0:
            names.height[0] -= 1
            name[c] = names.unused[names.height[0]]
        names.label[nodes[i]] = name[c]
        names.size[name[c]] += 1


@compiled
def _remainders(start, neighbour, cost, names, nodes):  # type: ignore[no-untyped-def]
    """The labels that keep members outside and attract a node or have lost one to the region."""
    found, count = np.empty(2 * len(nodes) + 1, np.int64), 0
    for a in nodes:
        found, count = _note(names, names.label[a], found, count)
        for e in range(start[a], start[a + 1]):
            if cost[e] < 0 and names.local[neighbour[e]] < 0:
                found, count = _note(names, names.label[neighbour[e]], found, count)
    return found[:count]


@compiled
def _note(names, c, found, count):  # type: ignore[no-untyped-def]
    if names.size[c] == 0 or names.remainder[c] >= 0:
        return found, count
    if count == len(found):
        found = np.concatenate((found, np.empty(count, np.int64)))
    names.remainder[c] = count
    found[count] = c
    return found, count + 1


@compiled
def _tokens(token_start, token, carrier, names, nodes, kept):  # type: ignore[no-untyped-def]
    """Local token lists: of the nodes, and, of these tokens, those that each remainder holds.

    All remainders carry one more token, so that no two of them join.
    """
    free = len(nodes)
    local, used = _renumber(token_start, token, names, nodes)
    start = np.ones(free + kept + 1, np.int64)
    start[0] = 0
    for i in range(free):
        start[i + 1] = token_start[nodes[i] + 1] - token_start[nodes[i]]
    holder, held, count = _held(carrier, names, local[: used if kept > 0 else 0])
    for p in range(count):
        start[free + holder[p] + 1] += 1
    start = np.cumsum(start)
    own, fill = np.empty(start[-1], np.int32), start[:-1].copy()
    for i in range(free):
        for e in range(token_start[nodes[i]], token_start[nodes[i] + 1]):
            own[fill[i]] = names.renumbered[token[e]]
            fill[i] += 1
    for p in range(count):
        own[fill[free + holder[p]]] = held[p]
        fill[free + holder[p]] += 1
    for r in range(free, free + kept):
        own[fill[r]] = used
    for t in range(used):
        names.renumbered[local[t]] = -1
    return start, own


@compiled
def _held(carrier, names, tokens):  # type: ignore[no-untyped-def]
    """Which remainder holds which of the tokens: two lists and their length."""
    start, node = carrier
    holder, held, count = np.empty(16, np.int64), np.empty(16, np.int64), 0
    for t in range(len(tokens)):
        for e in range(start[tokens[t]], start[tokens[t] + 1]):
            r = names.remainder[names.label[node[e]]]
            if r >= 0 and names.local[node[e]] < 0:
                if count == len(held):
                    holder = np.concatenate((holder, np.empty(count, np.int64)))
                    held = np.concatenate((held, np.empty(count, np.int64)))
                holder[count], held[count] = r, t
                count += 1
    return holder, held, count


@compiled
def _renumber(token_start, token, names, nodes):  # type: ignore[no-untyped-def]
    """Number the tokens of the nodes from 0; returns them in that order, and how many there are."""
    total = 0
    for a in nodes:
        total += token_start[a + 1] - token_start[a]
    local, used = np.empty(total, np.int64), 0
    for a in nodes:
        for e in range(token_start[a], token_start[a + 1]):
            if names.renumbered[token[e]] < 0:
                names.renumbered[token[e]] = used
                local[used] = token[e]
                used += 1
    return local, used


@compiled
def _forget_conflicts(weight, own_start, own, free):  # type: ignore[no-untyped-def]
    """Costs between a node and a remainder that holds one of its tokens do not count."""
    k = len(weight)
    tokens = 0
    for t in own:
        tokens = max(tokens, t + 1)
    holds = np.zeros(tokens, np.bool_)
    for r in range(free, k):
        for e in range(own_start[r], own_start[r + 1]):
            holds[own[e]] = True
        for i in range(free):
            for e in range(own_start[i], own_start[i + 1]):
                if holds[own[e]]:
                    weight[i, r] = weight[r, i] = 0.0
        for e in range(own_start[r], own_start[r + 1]):
            holds[own[e]] = False
