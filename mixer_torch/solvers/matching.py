"""Re-matching of the nodes that carry one token to the clusters, by linear assignment."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.clustering import enter, leave
from mixer_torch.solvers.compiled import compiled


@compiled
def assign(cost, rows, columns, match, row_price, column_price):  # type: ignore[no-untyped-def]
    """Minimum-cost assignment of each row to a column of its own, by shortest augmenting paths.

        minimise  sum over rows of cost[row, match(row)],  all match(row) different

    The Hungarian method in the form of Jonker and Volgenant (Computing 38, 1987), rows <= columns.

    Args:
        cost: Scratch of at least (rows, columns).
        rows: Number of rows.
        columns: Number of columns.
        match: (columns,) int64, written: the row of each column, -1 for none.
        row_price: (rows,) float scratch.
        column_price: (columns,) float scratch.
    """
    match[:columns] = -1
    row_price[:rows] = 0.0
    column_price[:columns] = 0.0
    distance = np.empty(columns)
    came_from = np.empty(columns, np.int64)
    done = np.empty(columns, np.bool_)
    for row in range(rows):
        distance[:] = np.inf
        done[:] = False
        current, last = row, -1
        while current >= 0:
            nearest, best = -1, np.inf
            reached = 0.0 if last < 0 else distance[last]
            for c in range(columns):
                if done[c]:
                    continue
                through = reached + cost[current, c] - row_price[current] - column_price[c]
                if through < distance[c]:
                    distance[c] = through
                    came_from[c] = last
                if distance[c] < best:
                    nearest, best = c, distance[c]
            done[nearest] = True
            last = nearest
            current = match[nearest]
        total = distance[last]
        row_price[row] += total
        for c in range(columns):
            if done[c] and c != last:
                row_price[match[c]] += total - distance[c]
                column_price[c] -= total - distance[c]
        while last >= 0:
            before = came_from[last]
            match[last] = match[before] if before >= 0 else row
            last = before


@compiled
def rematch(state, carrier_start, carrier, since, tiny):  # type: ignore[no-untyped-def]
    """Give the carriers of each token in turn their best clusters, all at once.

    Carriers of one token are never together, so their costs to a cluster do not depend on where
    the others go, and the best simultaneous choice is a linear assignment. A cluster is open to a
    carrier if no node but carriers of the token stands in its way; being alone costs 0.

    Returns:
        The change of the cost.
    """
    n = len(state.label)
    widest = 0
    for t in range(len(carrier_start) - 1):
        widest = max(widest, carrier_start[t + 1] - carrier_start[t])
    cost = np.empty((widest, n + 1 + widest))
    match = np.empty(n + 1 + widest, np.int64)
    row_price, column_price = np.empty(widest), np.empty(n + 1 + widest)
    choice = np.empty(widest, np.int64)
    gained = 0.0
    for t in range(len(carrier_start) - 1):
        nodes = carrier[carrier_start[t] : carrier_start[t + 1]]
        if not _conflict(state, nodes, since, tiny):
            continue
        rows, slots = len(nodes), state.number[0]
        before = 0.0
        for r in range(rows):
            i = nodes[r]
            before += state.total[state.label[i], i]
            for p in range(slots):
                value = state.total[state.slot[p], i]
                open_ = value < -tiny and _open(state, i, state.slot[p], t)
                cost[r, p] = value if open_ else 0.0
            cost[r, slots : slots + rows] = 0.0
        assign(cost, rows, slots + rows, match, row_price, column_price)
        after = 0.0
        choice[:rows] = -1
        for p in range(slots):
            if match[p] >= 0 and cost[match[p], p] < 0:
                choice[match[p]] = state.slot[p]
                after += cost[match[p], p]
        if after < before - tiny:
            gained += after - before
            _follow(state, nodes, choice)
    return gained


@compiled
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


@compiled
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


@compiled
def _follow(state, nodes, choice):  # type: ignore[no-untyped-def]
    """Move the nodes that change to their choice, -1 for a slot of one's own."""
    moved = np.zeros(len(nodes), np.bool_)
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
