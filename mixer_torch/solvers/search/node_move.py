"""Node moves: single nodes go to the cluster where they cost least."""

from __future__ import annotations

from mixer_torch.solvers.compiled import NONE, inner
from mixer_torch.solvers.search.clustering import fits, move


@inner
def move_nodes(state, since, tiny):
    """Move single nodes to where they cost least, until no move lowers the cost.

    Only moves from or into slots that changed after the time ``since`` are considered.

    Returns:
        The change of the cost.
    """
    n, gained, changed = len(state.label), 0.0, state.listed[0]
    while True:
        now, count = state.number[1], 0
        for p in range(state.number[0]):
            if state.stamp[state.slot[p]] > since:
                changed[count] = state.slot[p]
                count += 1
        if count == 0:
            return gained
        for i in range(n):
            own = state.label[i]
            stay = state.total[own, i]
            best, target = stay - tiny, NONE
            if best > 0 and state.size[own] > 1:
                best, target = 0.0, state.slot[state.number[0]]
            everywhere = state.stamp[own] > since
            for p in range(state.number[0] if everywhere else count):
                c = state.slot[p] if everywhere else changed[p]
                if state.total[c, i] < best and c != own and fits(state, i, c):
                    best, target = state.total[c, i], c
            if target >= 0:
                move(state, i, target)
                gained += best - stay
        since = now
