"""Kernighan-Lin exchange between two clusters, within the cannot-link constraints."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import NONE, compiled, inner
from mixer_torch.solvers.search.clustering import enter, first_of, leave, list_slots


class Exchange(NamedTuple):
    """Scratch of :func:`exchange`, for n nodes.

    Nodes of the two clusters that share a group must be on opposite sides, so they change sides
    together: the connected components of that relation are the units that move.
    """

    node: np.ndarray  # (n,) the nodes of both clusters
    unit: np.ndarray  # (n,) the unit of each of them
    side: np.ndarray  # (n,) the cluster that each is in, 0 or 1, along the chain
    gain: np.ndarray  # (n,) change of the cost if the node alone changed sides
    flip: np.ndarray  # (n,) change of the cost if a unit changed sides
    chain: np.ndarray  # (n,) the units in the order in which they changed
    locked: np.ndarray  # (n,) whether the unit has changed
    position: np.ndarray  # (n,) place in ``node`` of each node of the graph


@compiled
def exchange_scratch(n):
    """Scratch for graphs of up to n nodes."""
    return Exchange(
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n),
        np.empty(n),
        np.empty(n, np.int64),
        np.empty(n, np.bool_),
        np.empty(n, np.int64),
    )


@inner
def exchange_all(state, scratch, since, tiny):
    """Exchange between each slot that changed and every slot that attracts one of its nodes.

    The empty slot counts as attractive for clusters of three or more nodes, which it may split.

    Returns:
        The change of the cost.
    """
    gained = 0.0
    for p in range(list_slots(state, state.listed[0])):
        c = state.listed[0, p]
        if state.stamp[c] <= since or state.size[c] == 0:
            continue
        others = list_slots(state, state.listed[1])
        state.listed[1, others] = state.slot[others]
        for q in range(others + 1):
            other = state.listed[1, q]
            if state.size[c] == 0:
                break
            empty = state.size[other] == 0
            if other == c or (state.stamp[other] > since and other < c and not empty):
                continue
            if empty and (state.size[c] < 3 or state.place[other] != state.number[0]):
                continue
            if empty or _attracted(state, c, other):
                gained += exchange(state, scratch, c, other, tiny)
    return gained


@inner
def _attracted(state, c, other):
    """Whether a node of slot c has a negative cost to slot other."""
    i = first_of(state, c)
    while i < len(state.label):
        if state.total[other, i] < 0:
            return True
        i = state.after[i]
    return False


@inner
def exchange(state, scratch, first, second, tiny):
    """The best prefix of a chain of changes of side, each the cheapest that is left.

        minimise  cost inside the two clusters, over the sides of their units

    Kernighan and Lin, Bell System Technical Journal 49, 1970. With one cluster empty it splits the
    other, and a prefix that empties one joins them (Keuper et al., ICCV 2015). Exchanging some
    units gives the same two clusters as exchanging all others, so the chain takes half of them.

    Returns:
        The change of the cost, 0 where no prefix gains.
    """
    count = _gather(state, scratch, first, second)
    units = _units(state, scratch, first, second, count)
    _flips(state, scratch, count, units)
    cost, best, length = 0.0, -tiny, 0
    half = (units + 1) // 2
    for step in range(half):
        chosen = NONE
        for u in range(units):
            if not scratch.locked[u] and (chosen < 0 or scratch.flip[u] < scratch.flip[chosen]):
                chosen = u
        cost += scratch.flip[chosen]
        scratch.chain[step] = chosen
        scratch.locked[chosen] = True
        if cost < best:
            best, length = cost, step + 1
        if step + 1 < half:
            _change_sides(state, scratch, chosen, count)
    if length == 0:
        return 0.0
    for u in range(units):
        scratch.locked[u] = False
    for step in range(length):
        scratch.locked[scratch.chain[step]] = True
    _apply(state, scratch, first, second, count)
    return best


@inner
def _gather(state, scratch, first, second):
    """List the nodes of both clusters; returns their number."""
    count = 0
    for side in range(2):
        own, other = (first, second) if side == 0 else (second, first)
        i = first_of(state, own)
        while i < len(state.label):
            scratch.node[count] = i
            scratch.side[count] = side
            scratch.gain[count] = state.total[other, i] - state.total[own, i]
            scratch.position[i] = count
            count += 1
            i = state.after[i]
    return count


@inner
def _units(state, scratch, first, second, count):
    """Number the connected components of "shares a group"; returns how many there are."""
    for p in range(count):
        scratch.unit[p] = -1
    units = 0
    for p in range(count):
        if scratch.unit[p] >= 0:
            continue
        scratch.unit[p] = units
        scratch.chain[0] = p
        stack = 1
        while stack > 0:
            stack -= 1
            q = scratch.chain[stack]
            i = scratch.node[q]
            other = second if scratch.side[q] == 0 else first
            for e in range(state.group_start[i], state.group_start[i + 1]):
                j = state.holder[other, state.group[e]]
                if j >= 0 and scratch.unit[scratch.position[j]] < 0:
                    scratch.unit[scratch.position[j]] = units
                    scratch.chain[stack] = scratch.position[j]
                    stack += 1
        units += 1
    return units


@inner
def _flips(state, scratch, count, units):
    """Change of the cost by each unit: that of its nodes, without pairs inside it."""
    for u in range(units):
        scratch.flip[u] = 0.0
        scratch.locked[u] = False
    for p in range(count):
        u = scratch.unit[p]
        scratch.flip[u] += scratch.gain[p]
        if units < count:
            for q in range(p):
                if scratch.unit[q] == u:
                    twice = 2 * state.weight[scratch.node[p], scratch.node[q]]
                    scratch.flip[u] += twice if scratch.side[p] == scratch.side[q] else -twice


@inner
def _change_sides(state, scratch, chosen, count):
    """Update what the other units cost after one of them changes sides."""
    for p in range(count):
        if scratch.unit[p] != chosen:
            continue
        for q in range(count):
            u = scratch.unit[q]
            if not scratch.locked[u]:
                twice = 2 * state.weight[scratch.node[p], scratch.node[q]]
                scratch.flip[u] += twice if scratch.side[p] == scratch.side[q] else -twice
    for p in range(count):
        if scratch.unit[p] == chosen:
            scratch.side[p] = 1 - scratch.side[p]


@inner
def _apply(state, scratch, first, second, count):
    """Let the units that are marked as locked change sides: all leave, then all enter."""
    for p in range(count):
        if scratch.locked[scratch.unit[p]]:
            i = scratch.node[p]
            scratch.side[p] = 1 if state.label[i] == first else 0
            leave(state, i)
    for p in range(count):
        if scratch.locked[scratch.unit[p]]:
            enter(state, scratch.node[p], second if scratch.side[p] == 1 else first)
