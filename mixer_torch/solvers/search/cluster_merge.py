"""Cluster merges: two clusters that cost less as one are joined."""

from __future__ import annotations

from mixer_torch.solvers.compiled import NONE, inner
from mixer_torch.solvers.search.clustering import first_of, fits, list_slots, move


@inner
def merge_clusters(state, since, tiny):
    """Join each slot that changed after ``since`` with the one for which the cost falls most.

    Returns:
        The change of the cost.
    """
    gained = 0.0
    for q in range(list_slots(state, state.listed[0])):
        c = state.listed[0, q]
        if state.stamp[c] <= since or state.size[c] == 0:
            continue
        best, target = -tiny, NONE
        for p in range(state.number[0]):
            other = state.slot[p]
            if other != c:
                cost = _between(state, c, other)
                if cost < best and _compatible(state, c, other):
                    best, target = cost, other
        if target >= 0:
            while state.size[c] > 0:
                move(state, first_of(state, c), target)
            gained += best
    return gained


@inner
def _between(state, c, other):
    cost, i = 0.0, first_of(state, c)
    while i < len(state.label):
        cost += state.total[other, i]
        i = state.after[i]
    return cost


@inner
def _compatible(state, c, other):
    i = first_of(state, c)
    while i < len(state.label):
        if not fits(state, i, other):
            return False
        i = state.after[i]
    return True
