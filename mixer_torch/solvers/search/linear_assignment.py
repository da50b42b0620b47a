"""Re-matching of the nodes that carry one token to the clusters, by linear assignment."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import NONE, compiled, inner
from mixer_torch.solvers.search.clustering import enter, leave


class Matching(NamedTuple):
    """Scratch of :func:`rematch` and :func:`assign`, for r rows and q columns.

    Args:
        cost: (r, q) of each row in each column.
        match: (q,) the row of each column, -1 for none.
        row_price: (r,) and
        column_price: (q,) dual variables.
        distance: (q,) reduced cost of the shortest path to a column,
        came_from: (q,) the column before it on that path,
        done: (q,) and whether it is final.
        choice: (r,) the slot of each row.
        moved: (r,) whether it is another one than before.
    """

    cost: np.ndarray
    match: np.ndarray
    row_price: np.ndarray
    column_price: np.ndarray
    distance: np.ndarray
    came_from: np.ndarray
    done: np.ndarray
    choice: np.ndarray
    moved: np.ndarray


@compiled
def matching_scratch(rows, columns):  # type: ignore[no-untyped-def]
    """Scratch for problems of up to that size."""
    return Matching(
        np.empty((rows, columns)),
        np.empty(columns, np.int64),
        np.empty(rows),
        np.empty(columns),
        np.empty(columns),
        np.empty(columns, np.int64),
        np.empty(columns, np.bool_),
        np.empty(rows, np.int64),
        np.empty(rows, np.bool_),
    )


@inner
def assign(scratch, rows, columns):  # type: ignore[no-untyped-def]
    """Minimum-cost assignment of each row to a column of its own, by shortest augmenting paths.

        minimise  sum over rows of cost[row, match(row)],  all match(row) different

    The Hungarian method in the form of Jonker and Volgenant (Computing 38, 1987), rows <= columns.
    ``scratch.cost`` is read, ``scratch.match`` is the result.
    """
    match, distance = scratch.match, scratch.distance
    row_price, column_price = scratch.row_price, scratch.column_price
    for c in range(columns):
        match[c] = -1
        column_price[c] = 0.0
    for row in range(rows):
        row_price[row] = 0.0
    for row in range(rows):
        last = _shortest_path(scratch, row, columns)
        total = distance[last]
        row_price[row] += total
        for c in range(columns):
            if scratch.done[c] and c != last:
                row_price[match[c]] += total - distance[c]
                column_price[c] -= total - distance[c]
        while last >= 0:
            before = scratch.came_from[last]
            match[last] = match[before] if before >= 0 else row
            last = before


@inner
def _shortest_path(scratch, row, columns):  # type: ignore[no-untyped-def]
    """From a row to the nearest column without one, which is returned."""
    distance, done = scratch.distance, scratch.done
    for c in range(columns):
        distance[c] = np.inf
        done[c] = False
    current, last = row, NONE
    while current >= 0:
        nearest, best = NONE, np.inf
        reached = 0.0 if last < 0 else distance[last]
        for c in range(columns):
            if done[c]:
                continue
            reduced = scratch.cost[current, c] - scratch.row_price[current]
            through = reached + reduced - scratch.column_price[c]
            if through < distance[c]:
                distance[c] = through
                scratch.came_from[c] = last
            if distance[c] < best:
                nearest, best = c, distance[c]
        done[nearest] = True
        last = nearest
        current = scratch.match[nearest]
    return last


@inner
def rematch(state, scratch, carrier_start, carrier, since, tiny):  # type: ignore[no-untyped-def]
    """Give the carriers of each token in turn their best clusters, all at once.

    Carriers of one token are never together, so their costs to a cluster do not depend on where
    the others go, and the best simultaneous choice is a linear assignment. A cluster is open to a
    carrier if no node but carriers of the token stands in its way; being alone costs 0.

    Returns:
        The change of the cost.
    """
    gained = 0.0
    for t in range(len(carrier_start) - 1):
        nodes = carrier[carrier_start[t] : carrier_start[t + 1]]
        if not _conflict(state, nodes, since, tiny):
            continue
        rows, slots = len(nodes), state.number[0]
        before = _pose(state, scratch, nodes, t, tiny)
        assign(scratch, rows, slots + rows)
        after = 0.0
        for r in range(rows):
            scratch.choice[r] = -1
        for p in range(slots):
            row = scratch.match[p]
            if row >= 0 and scratch.cost[row, p] < 0:
                scratch.choice[row] = state.slot[p]
                after += scratch.cost[row, p]
        if after < before - tiny:
            gained += after - before
            _follow(state, scratch, nodes)
    return gained


@inner
def _pose(state, scratch, nodes, t, tiny):  # type: ignore[no-untyped-def]
    """Costs of the assignment of the carriers of token t; returns what they cost now."""
    before, slots = 0.0, state.number[0]
    for r in range(len(nodes)):
        i = nodes[r]
        before += state.total[state.label[i], i]
        for p in range(slots):
            value = state.total[state.slot[p], i]
            open_ = value < -tiny and _open(state, i, state.slot[p], t)
            scratch.cost[r, p] = value if open_ else 0.0
        for q in range(len(nodes)):
            scratch.cost[r, slots + q] = 0.0
    return before


@inner
def _conflict(state, nodes, since, tiny):  # type: ignore[no-untyped-def]
    """Whether a node would rather be elsewhere, and either slot changed: else nothing is gained."""
    for i in nodes:
        own = state.label[i]
        stay = state.total[own, i] - tiny
        moved = state.stamp[own] > since
        for p in range(state.number[0]):
            c = state.slot[p]
            if state.total[c, i] < stay and (moved or state.stamp[c] > since):
                return True
    return False


@inner
def _open(state, i, c, t):  # type: ignore[no-untyped-def]
    if state.size[c] == 1 and state.holder[c, t] >= 0 and state.holder[c, t] != i:
        return False
    for e in range(state.token_start[i], state.token_start[i + 1]):
        j = state.holder[c, state.token[e]]
        if j >= 0 and j != i and state.token[e] != t:
            carries = False
            for f in range(state.token_start[j], state.token_start[j + 1]):
                carries = carries or state.token[f] == t
            if not carries:
                return False
    return True


@inner
def _follow(state, scratch, nodes):  # type: ignore[no-untyped-def]
    """Move the nodes that change to their choice, -1 for a slot of one's own."""
    choice, moved = scratch.choice, scratch.moved
    for r in range(len(nodes)):
        i = nodes[r]
        alone = choice[r] < 0 and state.size[state.label[i]] == 1
        moved[r] = not alone and choice[r] != state.label[i]
        if moved[r]:
            leave(state, i)
    for r in range(len(nodes)):
        if moved[r] and choice[r] >= 0:
            enter(state, nodes[r], choice[r])
    for r in range(len(nodes)):
        if moved[r] and choice[r] < 0:
            enter(state, nodes[r], state.slot[state.number[0]])
