"""A clustering of a small dense graph that moves keep up to date, and the moves themselves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import NONE, compiled, inner


class Clustering(NamedTuple):
    """The state that the compiled moves read and write; k = n + 1 slots hold the clusters.

    Args:
        weight: (n, n) symmetric costs, 0 on the diagonal and for pairs that share a token.
        token_start: (n + 1,) and
        token: (K,) the tokens of each node.
        label: (n,) slot of each node.
        total: (k, n) cost of each node to all of the members of a slot.
        size: (k,) members.
        after: (n + k,) and
        before: (n + k,) the members of each slot as a ring; entry n + c stands for slot c in it.
        slot: (k,) the slots, those in use first.
        place: (k,) where in ``slot`` each one is.
        holder: (k, T) which member carries a token, -1 if none does.
        stamp: (k,) when each slot last changed.
        number: (2,) slots in use; the clock.
        listed: (2, k) scratch: slots that are gone through while slots change.
        value: (k,) scratch: of the slots in use, and an empty one.
    """

    weight: np.ndarray
    token_start: np.ndarray
    token: np.ndarray
    label: np.ndarray
    total: np.ndarray
    size: np.ndarray
    after: np.ndarray
    before: np.ndarray
    slot: np.ndarray
    place: np.ndarray
    holder: np.ndarray
    stamp: np.ndarray
    number: np.ndarray
    listed: np.ndarray
    value: np.ndarray


@compiled
def build(weight, token_start, token, label):  # type: ignore[no-untyped-def]
    """The state of given labels in 0..n; the labels are copied."""
    n = len(label)
    tokens = 0
    for t in token:
        tokens = max(tokens, t + 1)
    state = Clustering(
        weight,
        token_start,
        token,
        np.empty(n, np.int64),
        np.empty((n + 1, n)),
        np.empty(n + 1, np.int64),
        np.empty(2 * n + 1, np.int64),
        np.empty(2 * n + 1, np.int64),
        np.empty(n + 1, np.int64),
        np.empty(n + 1, np.int64),
        np.empty((n + 1, tokens), np.int64),
        np.empty(n + 1, np.int64),
        np.empty(2, np.int64),
        np.empty((2, n + 1), np.int64),
        np.empty(n + 1),
    )
    _fill(state, label)
    return state


@inner
def _fill(state, label):  # type: ignore[no-untyped-def]
    """Empty slots, which the nodes enter one after the other."""
    n, tokens = state.total.shape[1], state.holder.shape[1]
    for c in range(n + 1):
        state.size[c] = state.stamp[c] = 0
        state.after[n + c] = state.before[n + c] = n + c
        state.slot[c] = state.place[c] = c
        for i in range(n):
            state.total[c, i] = 0.0
        for t in range(tokens):
            state.holder[c, t] = -1
    state.number[0] = state.number[1] = 0
    for i in range(n):
        enter(state, i, label[i])


@inner
def enter(state, i, c):  # type: ignore[no-untyped-def]
    """Node i, which is in no slot, joins slot c."""
    _link(state, i, c)
    _add_row(state.total, c, state.weight, i)


@inner
def leave(state, i):  # type: ignore[no-untyped-def]
    """Node i leaves its slot and is in none.

    A token's holder is forgotten only if it is i: in the middle of an exchange the one that comes
    in may have taken the token over already.
    """
    c = state.label[i]
    _unlink(state, i, c)
    if state.size[c] > 0:
        _subtract_row(state.total, c, state.weight, i)


@inner
def move(state, i, c):  # type: ignore[no-untyped-def]
    """Node i goes to slot c."""
    own = state.label[i]
    _unlink(state, i, own)
    _link(state, i, c)
    if state.size[own] > 0:
        _shift_row(state.total, own, c, state.weight, i)
    else:
        _add_row(state.total, c, state.weight, i)


@inner
def trade(state, i, j):  # type: ignore[no-untyped-def]
    """Nodes i and j, of two slots, take each other's place."""
    own, c = state.label[i], state.label[j]
    state.label[i], state.label[j] = c, own
    _replace(state, i, j)
    for e in range(state.token_start[i], state.token_start[i + 1]):
        state.holder[own, state.token[e]] = -1
    for e in range(state.token_start[j], state.token_start[j + 1]):
        state.holder[c, state.token[e]] = -1
    for e in range(state.token_start[i], state.token_start[i + 1]):
        state.holder[c, state.token[e]] = i
    for e in range(state.token_start[j], state.token_start[j + 1]):
        state.holder[own, state.token[e]] = j
    state.number[1] += 1
    state.stamp[own] = state.stamp[c] = state.number[1]
    _trade_rows(state.total, own, c, state.weight, i, j)


@inner
def _replace(state, i, j):  # type: ignore[no-untyped-def]
    """Exchange the places of i and j in the rings of two slots."""
    ahead, behind = state.before[i], state.after[i]
    state.after[state.before[j]] = state.before[state.after[j]] = i
    state.before[i], state.after[i] = state.before[j], state.after[j]
    state.after[ahead] = state.before[behind] = j
    state.before[j], state.after[j] = ahead, behind


@inner
def _link(state, i, c):  # type: ignore[no-untyped-def]
    if state.size[c] == 0:
        _swap_place(state, c, state.number[0])
        state.number[0] += 1
    state.size[c] += 1
    state.label[i] = c
    slot = len(state.label) + c
    first = state.after[slot]
    state.after[i], state.before[i] = first, slot
    state.after[slot] = state.before[first] = i
    for e in range(state.token_start[i], state.token_start[i + 1]):
        state.holder[c, state.token[e]] = i
    state.number[1] += 1
    state.stamp[c] = state.number[1]


@inner
def _unlink(state, i, c):  # type: ignore[no-untyped-def]
    ahead, behind = state.before[i], state.after[i]
    state.after[ahead], state.before[behind] = behind, ahead
    for e in range(state.token_start[i], state.token_start[i + 1]):
        if state.holder[c, state.token[e]] == i:
            state.holder[c, state.token[e]] = -1
    state.size[c] -= 1
    state.number[1] += 1
    state.stamp[c] = state.number[1]
    if state.size[c] == 0:
        state.total[c] = 0.0
        state.number[0] -= 1
        _swap_place(state, c, state.number[0])


# Rows are added where the rest of the state is out of sight: so the compiler sees that they do not
# overlap with it, and takes several entries at a time.


@inner
def _add_row(total, c, weight, i):  # type: ignore[no-untyped-def]
    for j in range(total.shape[1]):
        total[c, j] += weight[i, j]


@inner
def _subtract_row(total, c, weight, i):  # type: ignore[no-untyped-def]
    for j in range(total.shape[1]):
        total[c, j] -= weight[i, j]


@inner
def _shift_row(total, own, c, weight, i):  # type: ignore[no-untyped-def]
    for j in range(total.shape[1]):
        value = weight[i, j]
        total[own, j] -= value
        total[c, j] += value


@inner
def _trade_rows(total, own, c, weight, i, k):  # type: ignore[no-untyped-def]
    for j in range(total.shape[1]):
        value = weight[i, j] - weight[k, j]
        total[own, j] -= value
        total[c, j] += value


@inner
def first_of(state, c):  # type: ignore[no-untyped-def]
    """The first member of slot c; ``state.after`` has the others, up to the end at n or more."""
    return state.after[len(state.label) + c]


@inner
def _swap_place(state, c, position):  # type: ignore[no-untyped-def]
    other, old = state.slot[position], state.place[c]
    state.slot[position], state.slot[old] = c, other
    state.place[c], state.place[other] = position, old


@inner
def list_slots(state, listed):  # type: ignore[no-untyped-def]
    """Write the slots in use to a list; returns their number."""
    for p in range(state.number[0]):
        listed[p] = state.slot[p]
    return state.number[0]


@inner
def fits(state, i, c):  # type: ignore[no-untyped-def]
    """Whether slot c holds none of the tokens of node i."""
    for e in range(state.token_start[i], state.token_start[i + 1]):
        if state.holder[c, state.token[e]] >= 0:
            return False
    return True


@inner
def restore(state, label):  # type: ignore[no-untyped-def]
    """Back to labels that were saved."""
    for i in range(len(label)):
        if state.label[i] != label[i]:
            move(state, i, label[i])


@inner
def relocate(state, since, tiny):  # type: ignore[no-untyped-def]
    """Move single nodes to where they cost least, until none gains by it.

    Only moves from or into slots that changed after the time ``since`` are looked at.

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


@inner
def merge(state, since, tiny):  # type: ignore[no-untyped-def]
    """Unite the pairs of slots that cost less as one; each changed slot with its best partner."""
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
def _between(state, c, other):  # type: ignore[no-untyped-def]
    cost, i = 0.0, first_of(state, c)
    while i < len(state.label):
        cost += state.total[other, i]
        i = state.after[i]
    return cost


@inner
def _compatible(state, c, other):  # type: ignore[no-untyped-def]
    i = first_of(state, c)
    while i < len(state.label):
        if not fits(state, i, other):
            return False
        i = state.after[i]
    return True
