"""The best of two clusterings, part by part where they differ."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import NONE, compiled, inner
from mixer_torch.solvers.search.clustering import restore


class Kept(NamedTuple):
    """The best clustering so far of n nodes, for a state of k slots.

    Args:
        label: (n,) slot of each node.
        cost: (n,) of each node to the rest of its cluster.
        credit: (n,) how often, and from how far, its cluster was found again since it was formed.
        root: (2 k,) scratch: the slots of the state, then those that are kept, as a forest of what
            belongs together;
        joined: (2 k,) how many joins made each tree,
        balance: (2 k,) and twice what the state costs there more than what is kept.
        target: (k,) scratch: where a kept slot goes.
        used: (k,) scratch: slots that are taken.
    """

    label: np.ndarray
    cost: np.ndarray
    credit: np.ndarray
    root: np.ndarray
    joined: np.ndarray
    balance: np.ndarray
    target: np.ndarray
    used: np.ndarray


@compiled
def keep(state, credit):  # type: ignore[no-untyped-def]
    """What the state is now, with the credit that its nodes have."""
    n, k = len(state.label), len(state.slot)
    kept = Kept(
        state.label.copy(),
        np.empty(n),
        credit,
        np.empty(2 * k, np.int64),
        np.empty(2 * k, np.int64),
        np.empty(2 * k),
        np.empty(k, np.int64),
        np.empty(k, np.bool_),
    )
    for i in range(n):
        kept.cost[i] = state.total[state.label[i], i]
    return kept


@inner
def recombine(state, kept, region, count, share, tiny):  # type: ignore[no-untyped-def]
    """Make the state and what is kept the better of the two, part by part.

    A part is a connected component of "share a node" among the clusters of both: no cluster of
    either reaches beyond it, so each part may be taken from the one or from the other, and the cost
    is the sum over parts (as partition crossover does for tours: Whitley, Hains and Howe, GECCO
    2009). At equal cost the state's is taken.

    Args:
        state: The clustering, written.
        kept: The best so far, written.
        region: Nodes that were moved about at random;
        count: how many. Those whose cluster is the same as before gain credit; where a lower cost
            is found, credit starts anew.
        share: How much credit.
        tiny: The least gain that counts.

    Returns:
        The change of the cost of what is kept, <= 0, and the number of nodes where the state was
        worse.
    """
    _compare(state, kept)
    for q in range(count):
        if kept.joined[_root(kept, state.label[region[q]])] == 1:
            kept.credit[region[q]] += share
    change, worse, lost, differs = 0.0, np.int64(0), False, False
    for i in range(len(state.label)):
        root = _root(kept, state.label[i])
        if kept.joined[root] == 1:
            continue
        balance = kept.balance[root]
        lost, differs = lost or balance > 0, True
        worse += balance > 2 * tiny
        if balance <= 0:
            change += 0.5 * (state.total[state.label[i], i] - kept.cost[i])
        if balance < -2 * tiny:
            kept.credit[i] = 0.0
    if lost:
        _go_back(state, kept)
    if differs:
        for i in range(len(state.label)):
            kept.label[i] = state.label[i]
            kept.cost[i] = state.total[state.label[i], i]
    return change, worse


@inner
def rest(state, kept, since):  # type: ignore[no-untyped-def]
    """Let clusters that came back count as not changed after a time: what is kept is at rest."""
    _compare(state, kept)
    for p in range(state.number[0]):
        if kept.joined[_root(kept, state.slot[p])] == 1:
            state.stamp[state.slot[p]] = since


@inner
def is_confirmed(kept, enough):  # type: ignore[no-untyped-def]
    """Whether all nodes have so much credit."""
    return kept.credit[np.argmin(kept.credit)] >= enough


@inner
def _compare(state, kept):  # type: ignore[no-untyped-def]
    """Join the slots that share a node, and sum up the balance of each tree."""
    n, k = len(state.label), len(state.slot)
    for i in range(n):
        for c in (state.label[i], k + kept.label[i]):
            kept.root[c], kept.joined[c], kept.balance[c] = c, 0, 0.0
    for i in range(n):
        a, b = _root(kept, state.label[i]), _root(kept, k + kept.label[i])
        if a != b:
            kept.root[b] = a
            kept.joined[a] += kept.joined[b] + 1
            kept.balance[a] += kept.balance[b]
        kept.balance[a] += state.total[state.label[i], i] - kept.cost[i]


@inner
def _root(kept, c):  # type: ignore[no-untyped-def]
    while kept.root[c] != c:
        kept.root[c] = kept.root[kept.root[c]]
        c = kept.root[c]
    return c


@inner
def _go_back(state, kept):  # type: ignore[no-untyped-def]
    """The state becomes what is kept where it is worse; kept labels become the state's.

    Kept clusters have their own slots again, unless those are taken by clusters that stay.
    """
    n = len(state.label)
    for c in range(len(state.slot)):
        kept.used[c], kept.target[c] = False, NONE
    for i in range(n):
        if _stays(kept, state.label[i]):
            kept.used[state.label[i]] = True
    free = np.int64(0)
    for i in range(n):
        c = kept.label[i]
        if _stays(kept, state.label[i]):
            kept.label[i] = state.label[i]
            continue
        if kept.target[c] < 0:
            while kept.used[free]:
                free += 1
            kept.target[c] = free if kept.used[c] else c
            kept.used[kept.target[c]] = True
        kept.label[i] = kept.target[c]
    restore(state, kept.label)


@inner
def _stays(kept, c):  # type: ignore[no-untyped-def]
    root = _root(kept, c)
    return kept.joined[root] == 1 or kept.balance[root] <= 0
