"""Simulated annealing: heat-bath moves of single nodes at a falling temperature."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.compiled import NONE, draw, inner, shuffle
from mixer_torch.solvers.search.clustering import move, swap

# Gumbel noise: the lowest of cost - temperature * noise is a draw from exp(-cost / temperature).
# Its quantiles in random order are drawn once, since logarithms would take most of the time. Their
# number is a power of two, so that an index wraps around by a mask.
_NOISES = 1024
_NOISE = -np.log(-np.log((np.random.default_rng(0).permutation(_NOISES) + 0.5) / _NOISES))
_SEVERAL = np.int64(-2)  # in place of one node


@inner
def anneal(state, nodes, count, hot, cold, sweeps, random):
    """Each of some nodes in turn draws a cluster, again and again at a falling temperature.

    A cluster in which the node costs v is drawn with probability proportional to
    exp(-v / temperature) (heat bath; Kirkpatrick, Gelatt, Vecchi, Science 220, 1983). Where one
    member shares a group with the node, the two swap places, and v is the change for both.

    Args:
        state: The clustering, written.
        nodes: Which nodes, put in random order.
        count: Their number.
        hot: Temperature of the first sweep.
        cold: Temperature of the last one.
        sweeps: How often each node draws.
        random: (1,) uint64 state of the random draws, written.

    Returns:
        The change of the cost.
    """
    changed, temperature = 0.0, hot
    ratio = (cold / hot) ** (1.0 / max(1, sweeps - 1))
    shuffle(random, nodes, count)
    for _ in range(sweeps):
        for q in range(count):
            changed += _redraw(state, nodes[q], draw(random, _NOISES), temperature)
        temperature *= ratio
    return changed


@inner
def _redraw(state, i, first, temperature):
    """Node i draws a cluster, with the noise from index ``first`` on; the change of the cost.

    Conflicts are only looked up in the clusters that cost least without them.
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
        extra = 0.0 if c == own else _conflict_cost(state, i, c)
        if state.value[p] + extra < best:
            best, target = state.value[p] + extra, c
        if extra <= 0:
            break
        state.value[p] = np.inf
    return 0.0 if target == own else _move_or_swap(state, i, target)


@inner
def _lowest(value, count):
    """Index of the lowest of the first values; without branches, which are unpredictable here."""
    best, lowest = np.inf, NONE
    for p in range(count):
        lower = value[p] < best
        lowest = p if lower else lowest
        best = value[p] if lower else best
    return lowest


@inner
def _conflict_cost(state, i, c):
    """Change of the cost by the node that makes room in slot c for node i; infinite if several."""
    j = _blocker(state, i, c)
    if j == NONE:
        return 0.0
    if j == _SEVERAL:
        return np.inf
    own = state.label[i]
    replaces = state.total[own, j] < 0 and _may_replace(state, i, j, own)
    return (state.total[own, j] if replaces else 0.0) - state.total[c, j]


@inner
def _move_or_swap(state, i, c):
    """Node i moves to slot c; the one in conflict takes its place, or a cluster of its own."""
    own, j = state.label[i], _blocker(state, i, c)
    change = state.total[c, i] - state.total[own, i]
    if j == NONE:
        move(state, i, c)
        return change
    change -= state.total[c, j]
    if state.total[own, j] < 0 and _may_replace(state, i, j, own):
        swap(state, i, j)
        return change + state.total[own, j]
    move(state, j, state.slot[state.number[0]])
    move(state, i, c)
    return change


@inner
def _blocker(state, i, c):
    """The only member of slot c that shares a group with node i, NONE or _SEVERAL."""
    found = NONE
    for e in range(state.group_start[i], state.group_start[i + 1]):
        j = state.holder[c, state.group[e]]
        if j >= 0 and j != found:
            if found != NONE:
                return _SEVERAL
            found = j
    return found


@inner
def _may_replace(state, i, j, c):
    """Whether j shares no group with the members of slot c other than i."""
    for e in range(state.group_start[j], state.group_start[j + 1]):
        k = state.holder[c, state.group[e]]
        if k >= 0 and k != i:
            return False
    return True
