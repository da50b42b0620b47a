"""Iterated local search on one dense graph: descend, disturb a region, descend, keep the better."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.clustering import build, cost_of, fits, merge, move, relocate, restore
from mixer_torch.solvers.compiled import compiled, draw, shuffle
from mixer_torch.solvers.exchange import exchange_all, exchange_scratch
from mixer_torch.solvers.matching import rematch

_PRECISION = 1e-11


@compiled
def search(weight, token_start, token, label, restarts, random, strategy):  # type: ignore[no-untyped-def]
    n = len(label)
    tiny = _PRECISION * np.abs(weight).max() if n else 0.0
    start_cost = 0.0
    carrier_start, carrier = _carriers(token_start, token)
    state = build(weight, token_start, token, label)
    scratch = exchange_scratch(n)
    start_cost = cost_of(state)
    cost = start_cost + descend(state, scratch, carrier_start, carrier, np.int64(-1), tiny, strategy)
    label[:] = state.label
    region = np.empty(n, np.int64)
    for _ in range(restarts):
        now = state.number[1]
        changed = disturb(state, region, random)
        changed += descend(state, scratch, carrier_start, carrier, now, tiny, strategy)
        if changed <= 0:
            cost += changed
            label[:] = state.label
        else:
            restore(state, label)
    return cost


@compiled
def descend(state, scratch, carrier_start, carrier, since, tiny, strategy):  # type: ignore[no-untyped-def]
    gained = 0.0
    matched, merged, exchanged = since, since, since
    while True:
        gained += relocate(state, since, tiny)
        since = state.number[1]
        now = state.number[1]
        if strategy & 1:
            gained += rematch(state, carrier_start, carrier, matched, tiny)
            matched = now
            if state.number[1] > now:
                continue
        if strategy & 2:
            gained += merge(state, merged, tiny)
            merged = now
            if state.number[1] > now:
                continue
        if strategy & 4:
            gained += exchange_all(state, scratch, exchanged, tiny)
            exchanged = now
        if state.number[1] == now:
            return gained


@compiled
def disturb(state, region, random):  # type: ignore[no-untyped-def]
    n = len(state.label)
    seed = draw(random, n)
    count = 0
    changed = 0.0
    clusters = 1 + draw(random, 3)
    c = state.label[seed]
    for r in range(clusters):
        i = state.head[c]
        while i >= 0:
            region[count] = i
            count += 1
            i = state.after[i]
        # next cluster: the best of three random ones for the seed
        nxt, best = -1, np.inf
        for _ in range(4):
            o = state.slot[draw(random, state.number[0])]
            taken = False
            for q in range(count):
                taken = taken or state.label[region[q]] == o
            if not taken:
                i = region[draw(random, count)]
                if state.total[o, i] < best:
                    nxt, best = o, state.total[o, i]
        if nxt < 0:
            break
        c = nxt
    shuffle(random, region, count)
    keep = draw(random, 3)
    if keep > 0:
        count = max(min(count, 2), count * keep // 3)
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
def _carriers(token_start, token):  # type: ignore[no-untyped-def]
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
