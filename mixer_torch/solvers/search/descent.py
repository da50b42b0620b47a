"""Variable neighbourhood descent: all kinds of moves in turn, until none lowers the cost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import compiled, inner
from mixer_torch.solvers.search.cluster_merge import merge_clusters
from mixer_torch.solvers.search.graph import group_members
from mixer_torch.solvers.search.kernighan_lin import Exchange, exchange_all, exchange_scratch
from mixer_torch.solvers.search.linear_assignment import (
    Assignment,
    assignment_scratch,
    reassign_groups,
)
from mixer_torch.solvers.search.node_move import move_nodes
from mixer_torch.solvers.search.partition_crossover import mark_unchanged

# Of float64 sums: gains below this fraction of the largest cost may be rounding errors.
PRECISION = 1e-11


class Moves(NamedTuple):
    """What the moves need besides the clustering."""

    member_start: (
        np.ndarray
    )  # (T + 1,) nodes of group t: member[member_start[t]:member_start[t + 1]]
    member: np.ndarray  # (K,)
    exchange: Exchange  # scratch of Kernighan-Lin exchanges
    assignment: Assignment  # scratch of linear assignments
    chosen: np.ndarray  # (n,) scratch: the nodes that a perturbation changes
    taken: np.ndarray  # (k,) scratch, False everywhere between restarts: slots of those nodes
    tiny: float  # the least gain that counts


@compiled
def build_moves(weight, group_start, group):
    """The scratch for a graph of n nodes, and which nodes each group has."""
    n, widest = len(weight), np.int64(0)
    start, member = group_members(group_start, group)
    for t in range(len(start) - 1):
        widest = max(widest, start[t + 1] - start[t])
    largest = 0.0
    for i in range(n):
        for j in range(i):
            largest = max(largest, abs(weight[i, j]))
    return Moves(
        start,
        member,
        exchange_scratch(n),
        assignment_scratch(widest, n + 1 + widest),
        np.empty(n, np.int64),
        np.zeros(n + 1, np.bool_),
        PRECISION * largest,
    )


@inner
def descend(state, moves, best, since):
    """All kinds of moves in turn, the cheap ones first, until none lowers the cost.

    Each kind skips clusters that have not changed since its last turn. Before the Kernighan-Lin
    exchange, which takes longest, clusters that equal one of the incumbent ``best`` are marked as
    unchanged, too.

    Args:
        state: The clustering, written.
        moves: Scratch and precision.
        best: The incumbent, which all moves have been tried on.
        since: Time up to which changes do not count; negative if all clusters are new.

    Returns:
        The change of the cost.
    """
    changed, tiny = 0.0, moves.tiny
    moved, assigned, merged, exchanged = since, since, since, since
    while True:
        changed += move_nodes(state, moved, tiny)
        now = moved = state.number[1]
        changed += reassign_groups(
            state, moves.assignment, moves.member_start, moves.member, assigned, tiny
        )
        assigned = now
        if state.number[1] == now:
            changed += merge_clusters(state, merged, tiny)
            merged = now
        if state.number[1] == now:
            if since >= 0:
                mark_unchanged(state, best, since)
            changed += exchange_all(state, moves.exchange, exchanged, tiny)
            exchanged = now
            if state.number[1] == now:
                return changed
