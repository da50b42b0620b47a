"""Ruin and recreate: clusters are taken apart, and their nodes put back greedily."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.compiled import NONE, draw, inner, shuffle
from mixer_torch.solvers.search.clustering import first_of, fits, move


@inner
def ruin_and_recreate(state, moves, settings, random):
    """Take a few clusters apart and put their nodes back in random order, each where it is best.

    Schrimpf, Schneider, Stamm-Wilbrandt, Dueck, Journal of Computational Physics 159, 2000. How
    many clusters is drawn each time, from two to almost all of a small problem: few take little
    time and are often enough, many leave deep local optima.

    Returns:
        The change of the cost.
    """
    nodes, changed = moves.chosen, 0.0
    clusters = 2 + draw(random, settings.ruined_clusters - 1)
    count = choose_nodes(state, moves, clusters, settings.ruined_nodes, settings.trials, random)
    shuffle(random, nodes, count)
    for q in range(count):
        i = nodes[q]
        changed -= state.total[state.label[i], i]
        move(state, i, state.slot[state.number[0]])
    for q in range(count):
        i = nodes[q]
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
def choose_nodes(state, moves, clusters, nodes, trials, random):
    """Choose clusters that attract each other, up to a number of them, or of their nodes.

    The next cluster is the one of ``trials`` drawn at random that costs a chosen node least.

    Returns:
        How many nodes they have; these are in ``moves.chosen``.
    """
    count, chosen = 0, moves.chosen
    if nodes >= len(state.label) and clusters >= len(state.label):
        for i in range(len(state.label)):
            chosen[i] = i
        return len(state.label)
    c = state.label[draw(random, len(state.label))]
    for _ in range(clusters):
        moves.taken[c] = True
        i = first_of(state, c)
        while i < len(state.label):
            chosen[count] = i
            count += 1
            i = state.after[i]
        c, best = NONE, np.inf
        for _ in range(trials):
            other = state.slot[draw(random, state.number[0])]
            cost = state.total[other, chosen[draw(random, count)]]
            if cost < best and not moves.taken[other]:
                c, best = other, cost
        if c < 0 or count >= nodes:
            break
    for q in range(count):
        moves.taken[state.label[chosen[q]]] = False
    return count
