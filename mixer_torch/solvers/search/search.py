"""Search on one dense graph: descend, disturb or reheat a region, descend, keep the better."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import NONE, compiled, draw, inner, shuffle
from mixer_torch.solvers.search.clustering import (
    build,
    first_of,
    fits,
    merge,
    move,
    relocate,
)
from mixer_torch.solvers.search.kernighan_lin import Exchange, exchange_all, exchange_scratch
from mixer_torch.solvers.search.linear_assignment import Matching, matching_scratch, rematch
from mixer_torch.solvers.search.partition_crossover import is_confirmed, keep, recombine, rest
from mixer_torch.solvers.search.simulated_annealing import reheat

PRECISION = 1e-11  # gains below this, relative to the largest cost, may be rounding
# what a search is resumed from, and what it did: an array of so many numbers
COURSE = 8
_ENOUGH, _MISSES, _SWEEPS = range(3)
RESTARTS, DESCENDED, REHEATED, DISTURBED, ENUMERATED = range(3, COURSE)
GAINS = {
    "enumeration": ENUMERATED,
    "descents": DESCENDED,
    "reheats": REHEATED,
    "disturbances": DISTURBED,
}
# how often each cluster is found again before a search ends: of few restarts, of many, and between
_FEW, _MANY, _RETURNS_BETWEEN = 0.03, 0.007, 6.0
_WITHOUT_TOKENS = 2.0  # times as often
_FRUITLESS = 4.0  # reheats that end above the best after which they get longer
_SWEEPS_FIRST = 20  # of a reheat
_SWEEPS_EACH = 20  # sweeps to a disturbance
# temperatures from which a reheat starts and at which it ends, in units of what a place costs
_HOTTEST, _COOLEST, _COLD, _COLD_WITHOUT_TOKENS = 0.6, 0.2, 0.1, 0.15
_LOCAL = 64  # nodes in the smallest region of reheats
_CLUSTERS = 16  # most clusters that a disturbance takes apart
_REGION = np.int64(64)  # nodes after which a disturbance takes no further cluster
_TRIALS = 4  # clusters that are drawn when the next one is chosen


class Moves(NamedTuple):
    """What the moves need besides the clustering: carriers of tokens, scratch, and the precision.

    Args:
        carrier_start: (T + 1,) and
        carrier: CSR of the nodes that carry each token.
        exchange: Scratch of exchanges.
        matching: Scratch of re-matching.
        region: (n,) the nodes that a restart is about.
        taken: (k,) scratch, False everywhere between restarts: slots in the region.
        tiny: The least gain that counts.
    """

    carrier_start: np.ndarray
    carrier: np.ndarray
    exchange: Exchange
    matching: Matching
    region: np.ndarray
    taken: np.ndarray
    tiny: float


def new_course(restarts: int) -> np.ndarray:
    """Where a search starts that is to take so many restarts, or as long as that is worth it."""
    course = np.zeros(COURSE)
    course[_ENOUGH] = max(min(restarts * _FEW, _RETURNS_BETWEEN), restarts * _MANY)
    return course


@compiled
def search(weight, token_start, token, label, limit, course, credit, random):  # type: ignore[no-untyped-def]
    """Improve labels in place; they never get worse.

    A restart reheats a region at random, and every other one then disturbs smaller ones; where the
    result is better, part by part (:func:`recombine`), it is kept. Where reheats keep coming back
    to every cluster there is, they are probably the optimum, and the search ends; other clusters of
    the same cost say nothing. Where reheats keep ending above it, they get longer.

    Args:
        weight: (n, n) symmetric costs, 0 on the diagonal and for pairs that share a token.
        token_start: (n + 1,) int64 and
        token: (K,) int32 the tokens of each node, 0..T-1.
        label: (n,) int64 in 0..n, feasible, written.
        limit: Restarts after which to stop, those before this call included.
        course: (COURSE,) float64, see :func:`new_course`: what the next call goes on from, and the
            number of restarts and the change of the cost by each kind of move so far.
        credit: (n,) float64 of each node, zero at first: how often its cluster was found again.
        random: (1,) uint64 state of the random draws, written.

    Returns:
        Whether the search ended before the limit.
    """
    state = build(weight, token_start, token, label)
    moves = _moves(weight, token_start, token)
    course[DESCENDED] += descend(state, moves, keep(state, credit), NONE)
    kept = keep(state, credit)
    ended = is_lowest(state, moves.tiny)
    if not ended:
        ended = _restarts(state, moves, kept, _typical_cost(state), limit, course, random)
    label[:] = kept.label
    return ended


@compiled
def _moves(weight, token_start, token):  # type: ignore[no-untyped-def]
    n, widest = len(weight), np.int64(0)
    start, carrier = carriers(token_start, token)
    for t in range(len(start) - 1):
        widest = max(widest, start[t + 1] - start[t])
    largest = 0.0
    for i in range(n):
        for j in range(i):
            largest = max(largest, abs(weight[i, j]))
    return Moves(
        start,
        carrier,
        exchange_scratch(n),
        matching_scratch(widest, n + 1 + widest),
        np.empty(n, np.int64),
        np.zeros(n + 1, np.bool_),
        PRECISION * largest,
    )


@inner
def _restarts(state, moves, kept, hot, limit, course, random):  # type: ignore[no-untyped-def]
    n = len(state.label)
    longest = max(_SWEEPS_FIRST, min(n * n // 100, 10_000_000 // (n * n)))
    course[_SWEEPS] = max(course[_SWEEPS], min(_SWEEPS_FIRST, longest))
    # a large one has more ways to go wrong, and so has one without tokens, which forbid many
    least, cold = 1.0, _COLD
    if len(moves.carrier_start) == 1:
        least, cold = _WITHOUT_TOKENS, _COLD_WITHOUT_TOKENS
    enough = course[_ENOUGH] * max(least, (n / _LOCAL) ** 1.5)
    levels = 1
    while n >> levels >= _LOCAL:
        levels += 1
    while course[RESTARTS] < limit:
        since = state.number[1]
        count = draw_region(state, moves, n, n >> draw(random, levels), random)
        start = _HOTTEST * (_COOLEST / _HOTTEST) ** (draw(random, 1024) / 1024)
        sweeps = np.int64(course[_SWEEPS])
        reheat(state, moves.region, count, hot * start, hot * cold, sweeps, random)
        rest(state, kept, since)
        descend(state, moves, kept, since)
        # one of all nodes from the highest temperature counts as 1: from near by it says less
        share = count / n * start / _HOTTEST
        change, worse = recombine(state, kept, moves.region, count, share, moves.tiny)
        course[REHEATED] += change + _settle(state, moves, kept, change, worse)
        _note_misses(course, change < -moves.tiny, worse / n * share, longest)
        for _ in range(sweeps // _SWEEPS_EACH if course[RESTARTS] % 2 == 1 else 0):
            since = state.number[1]
            disturb(state, moves, random)
            descend(state, moves, kept, since)
            change, worse = recombine(state, kept, moves.region, 0, 0.0, moves.tiny)
            course[DISTURBED] += change + _settle(state, moves, kept, change, worse)
        course[RESTARTS] += 1
        if is_confirmed(kept, enough):
            return True
    return False


@inner
def _settle(state, moves, kept, change, worse):  # type: ignore[no-untyped-def]
    """Descend from what was made of two clusterings; the further change of the cost."""
    total = 0.0
    while change < -moves.tiny and worse > 0:
        descend(state, moves, kept, NONE)
        change, worse = recombine(state, kept, moves.region, 0, 0.0, moves.tiny)
        total += change
    return total


@inner
def _note_misses(course, gained, missed, longest):  # type: ignore[no-untyped-def]
    """Count reheats in vain, and make them longer."""
    course[_MISSES] = 0.0 if gained else course[_MISSES] + missed
    if course[_MISSES] >= _FRUITLESS:
        course[_MISSES] = 0.0
        course[_SWEEPS] = min(2 * course[_SWEEPS], longest)


@inner
def descend(state, moves, kept, since):  # type: ignore[no-untyped-def]
    """All moves in turn, the cheap ones first, until none gains.

    What has not changed since a kind of move had its last turn is at rest already, and so are
    clusters that came back to what is kept: they are told before the dearest move.

    Returns:
        The change of the cost.
    """
    changed, tiny = 0.0, moves.tiny
    relocated, rematched, merged, exchanged = since, since, since, since
    while True:
        changed += relocate(state, relocated, tiny)
        now = relocated = state.number[1]
        changed += rematch(
            state, moves.matching, moves.carrier_start, moves.carrier, rematched, tiny
        )
        rematched = now
        if state.number[1] == now:
            changed += merge(state, merged, tiny)
            merged = now
        if state.number[1] == now:
            if since >= 0:
                rest(state, kept, since)
            changed += exchange_all(state, moves.exchange, exchanged, tiny)
            exchanged = now
            if state.number[1] == now:
                return changed


@inner
def is_lowest(state, tiny):  # type: ignore[no-untyped-def]
    """Whether all negative costs, and no positive ones, are inside clusters: nothing is lower."""
    for i in range(len(state.label)):
        for j in range(i):
            inside = state.label[i] == state.label[j]
            if (state.weight[i, j] > tiny) if inside else (state.weight[i, j] < -tiny):
                return False
    return True


@inner
def _typical_cost(state):  # type: ignore[no-untyped-def]
    """What a node costs at random in a cluster of average size: root mean square."""
    n, squares = len(state.label), 0.0
    for i in range(n):
        for j in range(i):
            squares += 2 * state.weight[i, j] ** 2
    return np.sqrt(squares / max(1, n - 1) / state.number[0])


@inner
def disturb(state, moves, random):  # type: ignore[no-untyped-def]
    """Take a few clusters apart and put their nodes back in random order, each where it is best.

    How many is drawn anew each time, from two to almost all of a small problem: small regions are
    cheap and often enough, large ones leave deep local optima.

    Returns:
        The change of the cost.
    """
    region, changed = moves.region, 0.0
    count = draw_region(state, moves, 2 + draw(random, _CLUSTERS - 1), _REGION, random)
    shuffle(random, region, count)
    for q in range(count):
        i = region[q]
        changed -= state.total[state.label[i], i]
        move(state, i, state.slot[state.number[0]])
    for q in range(count):
        i = region[q]
        stay = state.total[state.label[i], i]
        best, target = stay, NONE
        for p in range(state.number[0]):
            c = state.slot[p]
            if state.total[c, i] < best and fits(state, i, c):
                best, target = state.total[c, i], c
        if target >= 0:
            changed += best - stay
            move(state, i, target)
    return changed


@inner
def draw_region(state, moves, clusters, nodes, random):  # type: ignore[no-untyped-def]
    """Clusters that have to do with each other, until there are so many of them, or of nodes.

    Returns:
        How many nodes the region has.
    """
    count, region = 0, moves.region
    if nodes >= len(state.label) and clusters >= len(state.label):
        for i in range(len(state.label)):
            region[i] = i
        return len(state.label)
    c = state.label[draw(random, len(state.label))]
    for _ in range(clusters):
        moves.taken[c] = True
        i = first_of(state, c)
        while i < len(state.label):
            region[count] = i
            count += 1
            i = state.after[i]
        c, best = NONE, np.inf
        for _ in range(_TRIALS):
            other = state.slot[draw(random, state.number[0])]
            cost = state.total[other, region[draw(random, count)]]
            if cost < best and not moves.taken[other]:
                c, best = other, cost
        if c < 0 or count >= nodes:
            break
    for q in range(count):
        moves.taken[state.label[region[q]]] = False
    return count


@compiled
def carriers(token_start, token):  # type: ignore[no-untyped-def]
    """CSR of the nodes that carry each token."""
    tokens = 0
    for t in token:
        tokens = max(tokens, t + 1)
    start = np.zeros(tokens + 1, np.int64)
    for t in token:
        start[t + 1] += 1
    for t in range(tokens):
        start[t + 1] += start[t]
    fill = start[:tokens].copy()
    carrier = np.empty(len(token), np.int64)
    for i in range(len(token_start) - 1):
        for e in range(token_start[i], token_start[i + 1]):
            carrier[fill[token[e]]] = i
            fill[token[e]] += 1
    return start, carrier
