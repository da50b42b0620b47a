"""Iterated local search on one dense graph: descend, perturb, descend, keep the better parts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import NONE, compiled, draw, inner
from mixer_torch.solvers.search.clustering import build
from mixer_torch.solvers.search.descent import build_moves, descend
from mixer_torch.solvers.search.partition_crossover import (
    is_confirmed,
    mark_unchanged,
    new_incumbent,
    partition_crossover,
)
from mixer_torch.solvers.search.ruin_and_recreate import choose_nodes, ruin_and_recreate
from mixer_torch.solvers.search.simulated_annealing import anneal

# The search state, by which a search is resumed: an array of what it needs to know and what it did.
_ENOUGH, _MISSES, _SWEEPS, RESTARTS, DESCENT, ANNEALING, RUIN_AND_RECREATE, EXHAUSTIVE = range(8)
STATE_SIZE = 8
GAINS = {  # entries that hold the change of the cost by a kind of search
    "exhaustive": EXHAUSTIVE,
    "descent": DESCENT,
    "annealing": ANNEALING,
    "ruin_and_recreate": RUIN_AND_RECREATE,
}


class Settings(NamedTuple):
    """The numbers of the search.

    They were set by hand. ``benchmarks/sensitivity.py`` shows what half and twice of each do to the
    answers and to the time.
    """

    confirmations_few: float = 0.03  # how often clusters are found again before the search ends:
    confirmations_many: float = 0.007  # times ``restarts`` if these are few, or many,
    confirmations_between: float = 6.0  # and this number in between
    confirmations_ungrouped: float = 2.0  # times as often without groups, which rule much out
    full_size: int = 64  # nodes from which confirmations grow, by n^1.5; all smaller ones are
    # annealed as a whole, larger ones also by halves, quarters and so on, of this size at least
    misses: float = 4.0  # annealings that end above the best, after which they get longer
    sweeps: int = 20  # of an annealing at first
    sweeps_each: int = 20  # of annealing to each ruin and recreate
    hottest: float = 0.6  # highest temperature at the start, in units of the typical cost of a node
    coolest: float = 0.2  # lowest temperature at the start
    cold: float = 0.1  # temperature at the end, in the same units
    cold_ungrouped: float = 0.15  # the same without groups
    ruined_clusters: int = 16  # most clusters that are ruined at once
    ruined_nodes: int = 64  # nodes after which no further cluster is ruined
    trials: int = 4  # clusters that are drawn when the next one is chosen


SETTINGS = Settings()


def new_search_state(restarts: int) -> np.ndarray:
    """Where a search starts that takes so many restarts at most."""
    state = np.zeros(STATE_SIZE)
    state[_ENOUGH] = max(
        min(restarts * SETTINGS.confirmations_few, SETTINGS.confirmations_between),
        restarts * SETTINGS.confirmations_many,
    )
    return state


@compiled
def search(weight, group_start, group, label, limit, search_state, confirmed, settings, random):
    """Improve labels in place; they never get worse.

    A restart anneals some nodes, and every other one then ruins and recreates smaller sets; the
    better parts of the result are kept (:func:`partition_crossover`). Where annealing keeps finding
    every cluster of the incumbent again, that is probably the optimum, and the search ends; other
    clusters of the same cost do not count. Where it keeps ending above, annealings get longer.

    Args:
        weight: (n, n) symmetric costs, 0 on the diagonal and for pairs of one group.
        group_start: (n + 1,) int64 and
        group: (K,) int32 the groups of each node, 0..T-1.
        label: (n,) int64 in 0..n, feasible, written.
        limit: Restarts after which to stop, those before this call included.
        search_state: (STATE_SIZE,) float64, see :func:`new_search_state`, written: what the next
            call resumes from, and what each kind of search has changed the cost by so far.
        confirmed: (n,) float64, zero at first: how often the cluster of each node was found again.
        settings: The numbers of the search.
        random: (1,) uint64 state of the random draws, written.

    Returns:
        Whether the search ended before the limit.
    """
    state = build(weight, group_start, group, label)
    moves = build_moves(weight, group_start, group)
    search_state[DESCENT] += descend(state, moves, new_incumbent(state, confirmed), NONE)
    best = new_incumbent(state, confirmed)
    ended = is_lowest(state, moves.tiny)
    if not ended:
        hot = _typical_cost(state)
        ended = _restarts(state, moves, best, hot, limit, search_state, settings, random)
    label[:] = best.label
    return ended


@inner
def _restarts(state, moves, best, hot, limit, search_state, settings, random):
    n = len(state.label)
    # a sweep looks up some n^2 costs: the longest annealing grows with n^4, up to 1e7 look-ups
    longest = max(settings.sweeps, min(n * n // 100, 10_000_000 // (n * n)))
    search_state[_SWEEPS] = max(search_state[_SWEEPS], min(settings.sweeps, longest))
    least, cold = 1.0, settings.cold
    if len(moves.member_start) == 1:
        least, cold = settings.confirmations_ungrouped, settings.cold_ungrouped
    enough = search_state[_ENOUGH] * max(least, (n / settings.full_size) ** 1.5)
    levels = 1
    while n >> levels >= settings.full_size:
        levels += 1
    while search_state[RESTARTS] < limit:
        since = state.number[1]
        wanted = n >> draw(random, levels)
        count = choose_nodes(state, moves, n, wanted, settings.trials, random)
        start = settings.hottest * (settings.coolest / settings.hottest) ** (
            draw(random, 1024) / 1024
        )
        sweeps = np.int64(search_state[_SWEEPS])
        anneal(state, moves.chosen, count, hot * start, hot * cold, sweeps, random)
        mark_unchanged(state, best, since)
        descend(state, moves, best, since)
        # an annealing of all nodes from the highest temperature confirms most
        share = count / n * start / settings.hottest
        change, worse = partition_crossover(state, best, moves.chosen, count, share, moves.tiny)
        search_state[ANNEALING] += change + _settle(state, moves, best, change, worse)
        missed = 0.0 if change < -moves.tiny else search_state[_MISSES] + worse / n * share
        search_state[_MISSES] = missed
        if missed >= settings.misses:
            search_state[_MISSES] = 0.0
            search_state[_SWEEPS] = min(2 * search_state[_SWEEPS], longest)
        for _ in range(sweeps // settings.sweeps_each if search_state[RESTARTS] % 2 == 1 else 0):
            since = state.number[1]
            ruin_and_recreate(state, moves, settings, random)
            descend(state, moves, best, since)
            change, worse = partition_crossover(state, best, moves.chosen, 0, 0.0, moves.tiny)
            search_state[RUIN_AND_RECREATE] += change + _settle(state, moves, best, change, worse)
        search_state[RESTARTS] += 1
        if is_confirmed(best, enough):
            return True
    return False


@inner
def _settle(state, moves, best, change, worse):
    """Descend from the mixture of two clusterings; the further change of the cost."""
    total = 0.0
    while change < -moves.tiny and worse > 0:
        descend(state, moves, best, NONE)
        change, worse = partition_crossover(state, best, moves.chosen, 0, 0.0, moves.tiny)
        total += change
    return total


@inner
def is_lowest(state, tiny):
    """Whether all negative costs, and no positive ones, are inside clusters: nothing is lower."""
    for i in range(len(state.label)):
        for j in range(i):
            inside = state.label[i] == state.label[j]
            if (state.weight[i, j] > tiny) if inside else (state.weight[i, j] < -tiny):
                return False
    return True


@inner
def _typical_cost(state):
    """Root mean square of what a node costs in a random cluster of average size."""
    n, squares = len(state.label), 0.0
    for i in range(n):
        for j in range(i):
            squares += 2 * state.weight[i, j] ** 2
    return np.sqrt(squares / max(1, n - 1) / state.number[0])
