"""Linear assignment of one view: the nodes of a group choose their clusters all at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import NONE, compiled, inner
from mixer_torch.solvers.search.clustering import enter, leave


class Assignment(NamedTuple):
    """Scratch of :func:`reassign_groups` and :func:`assign`, for r rows and q columns."""

    cost: np.ndarray  # (r, q) of each row in each column
    match: np.ndarray  # (q,) the row of each column, -1 for none
    row_price: np.ndarray  # (r,) dual variables
    column_price: np.ndarray  # (q,) dual variables
    distance: np.ndarray  # (q,) reduced cost of the shortest path to a column
    came_from: np.ndarray  # (q,) the column before it on that path
    done: np.ndarray  # (q,) whether it is final
    choice: np.ndarray  # (r,) the slot of each row, -1 for a new one
    moved: np.ndarray  # (r,) whether it is another one than before


@compiled
def assignment_scratch(rows, columns):
    """Scratch for assignments of up to that size."""
    return Assignment(
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
def assign(scratch, rows, columns):
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
def _shortest_path(scratch, row, columns):
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
def reassign_groups(state, scratch, member_start, member, since, tiny):
    """Give the nodes of each group in turn their best clusters, by one linear assignment.

    Nodes of one group are never together, so their costs to a cluster do not depend on where the
    others go, and the best simultaneous choice is a linear assignment. A cluster is open to a node
    if no other node stands in the way but those of the group; being alone costs 0.

    Args:
        state: The clustering, written.
        scratch: An :class:`Assignment`, written.
        member_start: (T + 1,) and
        member: (K,) the nodes of each group, as :meth:`Graph.members` lists them.
        since: Groups are skipped where nothing that matters changed after this time.
        tiny: The least gain that counts.

    Returns:
        The change of the cost.
    """
    gained = 0.0
    for t in range(len(member_start) - 1):
        nodes = member[member_start[t] : member_start[t + 1]]
        if not _may_gain(state, nodes, since, tiny):
            continue
        rows, slots = len(nodes), state.number[0]
        before = _fill_costs(state, scratch, nodes, t, tiny)
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
            _move_to_choices(state, scratch, nodes)
    return gained


@inner
def _fill_costs(state, scratch, nodes, t, tiny):
    """Write the costs of the assignment of group t; returns what its nodes cost now."""
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
def _may_gain(state, nodes, since, tiny):
    """Whether a node costs less in another slot, and either slot changed: else nothing can gain."""
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
def _open(state, i, c, t):
    """Whether all nodes of slot c that share a group with node i are in group t, too."""
    if state.size[c] == 1 and state.holder[c, t] >= 0 and state.holder[c, t] != i:
        return False
    for e in range(state.group_start[i], state.group_start[i + 1]):
        j = state.holder[c, state.group[e]]
        if j >= 0 and j != i and state.group[e] != t:
            exempt = False
            for f in range(state.group_start[j], state.group_start[j + 1]):
                exempt = exempt or state.group[f] == t
            if not exempt:
                return False
    return True


@inner
def _move_to_choices(state, scratch, nodes):
    """All nodes that change leave their slots, then enter their choices."""
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
