"""Simulated annealing of a clustering: heat-bath moves of single nodes at a falling temperature."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.compiled import NONE, draw, inner, shuffle
from mixer_torch.solvers.search.clustering import move, trade

_NOISES = 1024  # a power of two
# Gumbel noise: the lowest of cost - temperature * noise is a draw from exp(-cost / temperature)
_NOISE = -np.log(-np.log((np.random.default_rng(0).permutation(_NOISES) + 0.5) / _NOISES))
_SEVERAL = np.int64(-2)  # in place of one node


@inner
def reheat(state, region, count, hot, cold, sweeps, random):  # type: ignore[no-untyped-def]
    """Each node of a region in turn draws a new place, again and again at a falling temperature.

    A place of cost v is drawn with probability proportional to exp(-v / temperature) (heat bath;
    Kirkpatrick, Gelatt, Vecchi, Science 220, 1983). Where one node stands in the way because it
    shares a token, the two trade places, and the cost is that of both.

    Args:
        state: The clustering, written.
        region: The nodes, which are put in a random order.
        count: Their number.
        hot: Temperature of the first sweep.
        cold: Temperature of the last one.
        sweeps: How many draws each node has.
        random: (1,) uint64 state of the random draws, written.

    Returns:
        The change of the cost.
    """
    changed, temperature = 0.0, hot
    ratio = (cold / hot) ** (1.0 / max(1, sweeps - 1))
    shuffle(random, region, count)
    for _ in range(sweeps):
        for q in range(count):
            changed += _redraw(state, region[q], draw(random, _NOISES), temperature)
        temperature *= ratio
    return changed


@inner
def _redraw(state, i, first, temperature):  # type: ignore[no-untyped-def]
    """Node i draws a place, with a stretch of the table as noise; the change of the cost.

    Who stands in the way is only asked for in places that are the cheapest without it.
    """
    own = state.label[i]
    count = state.number[0] + (state.size[own] > 1)
    for p in range(count):
        noise = temperature * _NOISE[(first + p) & (_NOISES - 1)]
        state.value[p] = state.total[state.slot[p], i] - noise
    best, target = np.inf, own
    while True:
        p = _lowest(state.value, count)
        if state.value[p] >= best:
            break
        c = state.slot[p]
        detour = 0.0 if c == own else _way_out(state, i, c)
        if state.value[p] + detour < best:
            best, target = state.value[p] + detour, c
        if detour <= 0:
            break
        state.value[p] = np.inf
    return 0.0 if target == own else _take_place(state, i, target)


@inner
def _lowest(value, count):  # type: ignore[no-untyped-def]
    """Index of the lowest of the first values, without branches, which are hard to predict here."""
    best, lowest = np.inf, NONE
    for p in range(count):
        lower = value[p] < best
        lowest = p if lower else lowest
        best = value[p] if lower else best
    return lowest


@inner
def _way_out(state, i, c):  # type: ignore[no-untyped-def]
    """Cost of the one that makes room in slot c for node i; infinite if there are several."""
    j = blocker(state, i, c)
    if j == NONE:
        return 0.0
    if j == _SEVERAL:
        return np.inf
    own = state.label[i]
    follows = state.total[own, j] < 0 and _may_follow(state, i, j, own)
    return (state.total[own, j] if follows else 0.0) - state.total[c, j]


@inner
def _take_place(state, i, c):  # type: ignore[no-untyped-def]
    """Node i goes to slot c; who stands in its way takes its place, or leaves for one alone."""
    own, j = state.label[i], blocker(state, i, c)
    change = state.total[c, i] - state.total[own, i]
    if j == NONE:
        move(state, i, c)
        return change
    change -= state.total[c, j]
    if state.total[own, j] < 0 and _may_follow(state, i, j, own):
        trade(state, i, j)
        return change + state.total[own, j]
    move(state, j, state.slot[state.number[0]])
    move(state, i, c)
    return change


@inner
def blocker(state, i, c):  # type: ignore[no-untyped-def]
    """The only member of slot c that shares a token with node i, NONE or _SEVERAL."""
    found = NONE
    for e in range(state.token_start[i], state.token_start[i + 1]):
        j = state.holder[c, state.token[e]]
        if j >= 0 and j != found:
            if found != NONE:
                return _SEVERAL
            found = j
    return found


@inner
def _may_follow(state, i, j, c):  # type: ignore[no-untyped-def]
    """Whether j may take the place of i in slot c."""
    for e in range(state.token_start[j], state.token_start[j + 1]):
        k = state.holder[c, state.token[e]]
        if k >= 0 and k != i:
            return False
    return True
