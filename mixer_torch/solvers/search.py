"""Iterated local search on one dense graph: descend, disturb a region, descend, keep the better."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.clustering import build, fits, merge, move, relocate, restore
from mixer_torch.solvers.compiled import compiled, draw, shuffle
from mixer_torch.solvers.exchange import exchange_all, exchange_scratch
from mixer_torch.solvers.matching import rematch

PRECISION = 1e-11  # gains below this, relative to the largest cost, may be rounding
_CLUSTERS = 16  # most clusters that a disturbance takes apart
_REGION = 64  # nodes after which a disturbance takes no further cluster
_TRIALS = 4  # clusters that are drawn when the next one is chosen


@compiled
def search(weight, token_start, token, label, patience, limit, failed, random):  # type: ignore[no-untyped-def]
    """Improve labels in place; they never get worse.

    Args:
        weight: (n, n) symmetric costs, 0 on the diagonal and for pairs that share a token.
        token_start: (n + 1,) int64 and
        token: (K,) int32 the tokens of each node, 0..T-1.
        label: (n,) int64 in 0..n, feasible, written.
        patience: Disturbances in a row that bring nothing after which the search ends.
        limit: Most disturbances.
        failed: How many brought nothing in a row before this call.
        random: (1,) uint64 state of the random draws, written.

    Returns:
        How many disturbances in a row brought nothing at the end.
    """
    tiny = PRECISION * np.abs(weight).max()
    carrier_start, carrier = carriers(token_start, token)
    state = build(weight, token_start, token, label)
    scratch = exchange_scratch(len(label))
    region = np.empty(len(label), np.int64)
    since = np.int64(-1)
    for restart in range(-1, limit):
        changed = 0.0
        if restart >= 0:
            since = state.number[1]
            changed = disturb(state, region, random)
        # all moves in turn, the cheap ones first, until none gains; what has not changed since
        # a kind of move had its last turn is at rest already
        relocated, rematched, merged, exchanged = since, since, since, since
        resting = False
        while not resting:
            changed += relocate(state, relocated, tiny)
            now = relocated = state.number[1]
            changed += rematch(state, carrier_start, carrier, rematched, tiny)
            rematched = now
            if state.number[1] == now:
                changed += merge(state, merged, tiny)
                merged = now
            if state.number[1] == now:
                changed += exchange_all(state, scratch, exchanged, tiny)
                exchanged = now
                resting = state.number[1] == now
        if changed <= 0:
            label[:] = state.label
        else:
            restore(state, label)
        if restart >= 0:
            failed = 0 if changed < -tiny else failed + 1
        if failed >= patience:
            break
    return failed


@compiled
def disturb(state, region, random):  # type: ignore[no-untyped-def]
    """Take a few clusters apart and put their nodes back in random order, each where it is best.

    How many is drawn anew each time, from two to almost all of a small problem: small regions are
    cheap and often enough, large ones leave deep local optima.

    Returns:
        The change of the cost.
    """
    count, changed = _draw_region(state, region, random), 0.0
    shuffle(random, region, count)
    for q in range(count):
        i = region[q]
        changed -= state.total[state.label[i], i]
        move(state, i, state.slot[state.number[0]])
    for q in range(count):
        i = region[q]
        stay = state.total[state.label[i], i]
        best, target = stay, -1
        for p in range(state.number[0]):
            c = state.slot[p]
            if state.total[c, i] < best and fits(state, i, c):
                best, target = state.total[c, i], c
        if target >= 0:
            changed += best - stay
            move(state, i, target)
    return changed


@compiled
def _draw_region(state, region, random):  # type: ignore[no-untyped-def]
    """The nodes of some clusters that have to do with each other; returns how many nodes."""
    count, wanted = 0, 2 + draw(random, _CLUSTERS - 1)
    c = state.label[draw(random, len(state.label))]
    for _ in range(wanted):
        i = state.head[c]
        while i >= 0:
            region[count] = i
            count += 1
            i = state.after[i]
        c, best = -1, np.inf
        for _ in range(_TRIALS):
            other = state.slot[draw(random, state.number[0])]
            cost = state.total[other, region[draw(random, count)]]
            if cost < best and not _contains(state, region, count, other):
                c, best = other, cost
        if c < 0 or count >= _REGION:
            break
    return count


@compiled
def _contains(state, region, count, slot):  # type: ignore[no-untyped-def]
    found = False
    for q in range(count):
        found = found or state.label[region[q]] == slot
    return found


@compiled
def carriers(token_start, token):  # type: ignore[no-untyped-def]
    """CSR of the nodes that carry each token."""
    tokens = 0
    for t in token:
        tokens = max(tokens, t + 1)
    start = np.zeros(tokens + 1, np.int64)
    for t in token:
        start[t + 1] += 1
    start = np.cumsum(start)
    fill = start[:tokens].copy()
    carrier = np.empty(len(token), np.int64)
    for i in range(len(token_start) - 1):
        for e in range(token_start[i], token_start[i + 1]):
            carrier[fill[token[e]]] = i
            fill[token[e]] += 1
    return start, carrier
