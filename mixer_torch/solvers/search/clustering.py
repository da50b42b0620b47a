"""A clustering of a small dense graph, with the sums that moves need, kept up to date.

Clusters are held in n + 1 slots, so that there is always an empty one. Each row of ``total`` is
changed with its slot, so a move costs O(n), and the gain of moving a node is a look-up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import compiled, inner


class Clustering(NamedTuple):
    """The clustering that the compiled moves read and write: n nodes, k = n + 1 slots."""

    weight: np.ndarray  # (n, n) symmetric costs, 0 on the diagonal and for pairs of one group
    group_start: np.ndarray  # (n + 1,) groups of node i: group[group_start[i]:group_start[i + 1]]
    group: np.ndarray  # (K,)
    label: np.ndarray  # (n,) slot of each node
    total: np.ndarray  # (k, n) cost of each node to all of the members of a slot
    size: np.ndarray  # (k,) members
    after: np.ndarray  # (n + k,) next and
    before: np.ndarray  # (n + k,) previous member of a slot, in a ring where n + c is slot c itself
    slot: np.ndarray  # (k,) the slots, those in use first
    place: np.ndarray  # (k,) where in ``slot`` each one is
    holder: np.ndarray  # (k, T) which member is in a group, -1 if none is
    stamp: np.ndarray  # (k,) the time when each slot last changed
    number: np.ndarray  # (2,) slots in use; the time: a count of changes
    listed: np.ndarray  # (2, k) scratch: slots that are gone through while slots change
    value: np.ndarray  # (k,) scratch: of the slots in use, and an empty one


@compiled
def build(weight, group_start, group, label):
    """The clustering of given labels in 0..n; the labels are copied."""
    n, groups = len(label), 0
    for t in group:
        groups = max(groups, t + 1)
    state = Clustering(
        weight,
        group_start,
        group,
        np.empty(n, np.int64),
        np.empty((n + 1, n)),
        np.empty(n + 1, np.int64),
        np.empty(2 * n + 1, np.int64),
        np.empty(2 * n + 1, np.int64),
        np.empty(n + 1, np.int64),
        np.empty(n + 1, np.int64),
        np.empty((n + 1, groups), np.int64),
        np.empty(n + 1, np.int64),
        np.empty(2, np.int64),
        np.empty((2, n + 1), np.int64),
        np.empty(n + 1),
    )
    _fill(state, label)
    return state


@inner
def _fill(state, label):
    """Empty all slots, then let the nodes enter one after the other."""
    n, groups = state.total.shape[1], state.holder.shape[1]
    for c in range(n + 1):
        state.size[c] = state.stamp[c] = 0
        state.after[n + c] = state.before[n + c] = n + c
        state.slot[c] = state.place[c] = c
        for i in range(n):
            state.total[c, i] = 0.0
        for t in range(groups):
            state.holder[c, t] = -1
    state.number[0] = state.number[1] = 0
    for i in range(n):
        enter(state, i, label[i])


@inner
def enter(state, i, c):
    """Node i, which is in no slot, joins slot c."""
    _link(state, i, c)
    _add_row(state.total, c, state.weight, i)


@inner
def leave(state, i):
    """Node i leaves its slot and is in none.

    The holder of a group is deleted only if it is i: in the middle of an exchange the node that
    takes i's place may have been entered as holder already.
    """
    c = state.label[i]
    _unlink(state, i, c)
    if state.size[c] > 0:
        _subtract_row(state.total, c, state.weight, i)


@inner
def move(state, i, c):
    """Node i moves to slot c."""
    own = state.label[i]
    _unlink(state, i, own)
    _link(state, i, c)
    if state.size[own] > 0:
        _shift_row(state.total, own, c, state.weight, i)
    else:
        _add_row(state.total, c, state.weight, i)


@inner
def swap(state, i, j):
    """Nodes i and j, of two slots, swap places."""
    own, c = state.label[i], state.label[j]
    state.label[i], state.label[j] = c, own
    _replace(state, i, j)
    for e in range(state.group_start[i], state.group_start[i + 1]):
        state.holder[own, state.group[e]] = -1
    for e in range(state.group_start[j], state.group_start[j + 1]):
        state.holder[c, state.group[e]] = -1
    for e in range(state.group_start[i], state.group_start[i + 1]):
        state.holder[c, state.group[e]] = i
    for e in range(state.group_start[j], state.group_start[j + 1]):
        state.holder[own, state.group[e]] = j
    state.number[1] += 1
    state.stamp[own] = state.stamp[c] = state.number[1]
    _swap_rows(state.total, own, c, state.weight, i, j)


@inner
def _replace(state, i, j):
    """Exchange the places of i and j in the rings of two slots."""
    ahead, behind = state.before[i], state.after[i]
    state.after[state.before[j]] = state.before[state.after[j]] = i
    state.before[i], state.after[i] = state.before[j], state.after[j]
    state.after[ahead] = state.before[behind] = j
    state.before[j], state.after[j] = ahead, behind


@inner
def _link(state, i, c):
    if state.size[c] == 0:
        _swap_place(state, c, state.number[0])
        state.number[0] += 1
    state.size[c] += 1
    state.label[i] = c
    slot = len(state.label) + c
    first = state.after[slot]
    state.after[i], state.before[i] = first, slot
    state.after[slot] = state.before[first] = i
    for e in range(state.group_start[i], state.group_start[i + 1]):
        state.holder[c, state.group[e]] = i
    state.number[1] += 1
    state.stamp[c] = state.number[1]


@inner
def _unlink(state, i, c):
    ahead, behind = state.before[i], state.after[i]
    state.after[ahead], state.before[behind] = behind, ahead
    for e in range(state.group_start[i], state.group_start[i + 1]):
        if state.holder[c, state.group[e]] == i:
            state.holder[c, state.group[e]] = -1
    state.size[c] -= 1
    state.number[1] += 1
    state.stamp[c] = state.number[1]
    if state.size[c] == 0:
        state.total[c] = 0.0
        state.number[0] -= 1
        _swap_place(state, c, state.number[0])


# Row sums are functions of their own, of arrays instead of the state: only so does the compiler
# see that the arrays do not overlap, and uses vector instructions.


@inner
def _add_row(total, c, weight, i):
    for j in range(total.shape[1]):
        total[c, j] += weight[i, j]


@inner
def _subtract_row(total, c, weight, i):
    for j in range(total.shape[1]):
        total[c, j] -= weight[i, j]


@inner
def _shift_row(total, own, c, weight, i):
    for j in range(total.shape[1]):
        value = weight[i, j]
        total[own, j] -= value
        total[c, j] += value


@inner
def _swap_rows(total, own, c, weight, i, k):
    for j in range(total.shape[1]):
        value = weight[i, j] - weight[k, j]
        total[own, j] -= value
        total[c, j] += value


@inner
def first_of(state, c):
    """The first member of slot c; ``state.after`` has the next ones, n or more ends them."""
    return state.after[len(state.label) + c]


@inner
def _swap_place(state, c, position):
    other, old = state.slot[position], state.place[c]
    state.slot[position], state.slot[old] = c, other
    state.place[c], state.place[other] = position, old


@inner
def list_slots(state, listed):
    """Write the slots in use to a list; returns their number."""
    for p in range(state.number[0]):
        listed[p] = state.slot[p]
    return state.number[0]


@inner
def fits(state, i, c):
    """Whether slot c has no node that shares a group with node i."""
    for e in range(state.group_start[i], state.group_start[i + 1]):
        if state.holder[c, state.group[e]] >= 0:
            return False
    return True


@inner
def restore(state, label):
    """Move nodes back to labels that were saved."""
    for i in range(len(label)):
        if state.label[i] != label[i]:
            move(state, i, label[i])
