"""Partition crossover: of two clusterings the better one, in each part in which they differ."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import NONE, compiled, inner
from mixer_torch.solvers.search.clustering import restore


class Incumbent(NamedTuple):
    """The best clustering so far of n nodes, for a state of k slots."""

    label: np.ndarray  # (n,) slot of each node
    cost: np.ndarray  # (n,) of each node to the rest of its cluster
    confirmed: np.ndarray  # (n,) how often its cluster was found again, a weighted count
    root: np.ndarray  # (2 k,) scratch: union-find of the state's slots, then the incumbent's
    joined: np.ndarray  # (2 k,) how many joins made each tree
    balance: np.ndarray  # (2 k,) twice what the state costs more than the incumbent in each tree
    target: np.ndarray  # (k,) scratch: where a slot of the incumbent goes
    used: np.ndarray  # (k,) scratch: slots that are taken


@compiled
def new_incumbent(state, confirmed):
    """The present state as the best so far, with a count of confirmations for each node."""
    n, k = len(state.label), len(state.slot)
    best = Incumbent(
        state.label.copy(),
        np.empty(n),
        confirmed,
        np.empty(2 * k, np.int64),
        np.empty(2 * k, np.int64),
        np.empty(2 * k),
        np.empty(k, np.int64),
        np.empty(k, np.bool_),
    )
    for i in range(n):
        best.cost[i] = state.total[state.label[i], i]
    return best


@inner
def partition_crossover(state, best, changed, count, weight, tiny):
    """Make the state and the incumbent the better of the two, part by part.

    A part is a connected component of "share a node" among the clusters of both: no cluster of
    either reaches beyond it, so each part may be taken from the one or from the other, and the cost
    is the sum over parts (partition crossover of tours: Whitley, Hains and Howe, GECCO 2009). At
    equal cost the state's is taken.

    Args:
        state: The clustering, written.
        best: The incumbent, written.
        changed: The nodes that were perturbed;
        count: how many. Those whose cluster is the same as before are confirmed; where a lower
            cost is found, the count of confirmations starts anew.
        weight: Of this confirmation.
        tiny: The least gain that counts.

    Returns:
        The change of the cost of the incumbent, <= 0, and the number of nodes where the state was
        worse.
    """
    _compare(state, best)
    for q in range(count):
        if best.joined[_root(best, state.label[changed[q]])] == 1:
            best.confirmed[changed[q]] += weight
    change, worse, lost, differs = 0.0, np.int64(0), False, False
    for i in range(len(state.label)):
        root = _root(best, state.label[i])
        if best.joined[root] == 1:
            continue
        balance = best.balance[root]
        lost, differs = lost or balance > 0, True
        worse += balance > 2 * tiny
        if balance <= 0:
            change += 0.5 * (state.total[state.label[i], i] - best.cost[i])
        if balance < -2 * tiny:
            best.confirmed[i] = 0.0
    if lost:
        _go_back(state, best)
    if differs:
        for i in range(len(state.label)):
            best.label[i] = state.label[i]
            best.cost[i] = state.total[state.label[i], i]
    return change, worse


@inner
def mark_unchanged(state, best, since):
    """Date clusters that equal one of the incumbent back: moves have tried them before."""
    _compare(state, best)
    for p in range(state.number[0]):
        if best.joined[_root(best, state.slot[p])] == 1:
            state.stamp[state.slot[p]] = since


@inner
def is_confirmed(best, enough):
    """Whether the cluster of every node was found again so often."""
    return best.confirmed[np.argmin(best.confirmed)] >= enough


@inner
def _compare(state, best):
    """Join the slots that share a node, and add up the balance of each tree."""
    n, k = len(state.label), len(state.slot)
    for i in range(n):
        for c in (state.label[i], k + best.label[i]):
            best.root[c], best.joined[c], best.balance[c] = c, 0, 0.0
    for i in range(n):
        a, b = _root(best, state.label[i]), _root(best, k + best.label[i])
        if a != b:
            best.root[b] = a
            best.joined[a] += best.joined[b] + 1
            best.balance[a] += best.balance[b]
        best.balance[a] += state.total[state.label[i], i] - best.cost[i]


@inner
def _root(best, c):
    while best.root[c] != c:
        best.root[c] = best.root[best.root[c]]
        c = best.root[c]
    return c


@inner
def _go_back(state, best):
    """The state becomes the incumbent where it is worse.

    Clusters return to the slots that they had, unless clusters that stay have taken those. The
    incumbent's labels become those of the new state.
    """
    n = len(state.label)
    for c in range(len(state.slot)):
        best.used[c], best.target[c] = False, NONE
    for i in range(n):
        if _stays(best, state.label[i]):
            best.used[state.label[i]] = True
    free = np.int64(0)
    for i in range(n):
        c = best.label[i]
        if _stays(best, state.label[i]):
            best.label[i] = state.label[i]
            continue
        if best.target[c] < 0:
            while best.used[free]:
                free += 1
            best.target[c] = free if best.used[c] else c
            best.used[best.target[c]] = True
        best.label[i] = best.target[c]
    restore(state, best.label)


@inner
def _stays(best, c):
    """Whether the state is not worse in the part of slot c."""
    root = _root(best, c)
    return best.joined[root] == 1 or best.balance[root] <= 0
