"""Dual ascent: a lower bound without a linear program, from multipliers of the cuts."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.proof.cuts import Cuts, PairVariables, lagrangian_bound, separate

# Set by hand; benchmarks/sensitivity.py shows what half and twice of each do to bound and time.
SOFTEST, HARDEST, SOFTENING = 0.3, 0.003, 0.92  # temperature t at first, at last, factor of a round
SWEEPS = 10  # over all cuts, between two searches for new ones
ROUNDS = 10  # over which an ascent at the last temperature has to gain
LEAST_GAIN = 1e-4  # by this fraction of the bound, or it ends
SMALL = 1e-6  # multipliers below it are dropped with their cuts
VIOLATION = 0.02  # of a new cut, at least
STARTS = 40  # attempts at each node to find one; so many times n new cuts in a round at most


class Ascent(NamedTuple):
    """What dual ascent proved."""

    bound: float  # no clustering costs less
    # (n, n) reduced costs: a clustering that departs from their sign at a pair costs
    # bound + |reduced| or more; 0 for pairs that may not be together
    reduced: np.ndarray
    cuts: Cuts  # those with a multiplier above 0, which a linear program would start with


def ascend(
    cost: Float64[np.ndarray, "n n"],
    conflict: Bool[np.ndarray, "n n"],
    deadline: float,
    target: float = np.inf,
) -> Ascent:
    """Maximise the Lagrangian bound of the 2-partition inequalities, over the inequalities too.

        L(y) = sum_e min(0, cost_e + (A^T y)_e) - sum y,      y >= 0, one for each cut A x <= 1

    L(y) bounds the optimum for any y >= 0, so only its value has to be computed with care, and it
    may be maximised in whatever way is fast: the minimum is softened to -t log(1 + exp(-r / t))
    with r = cost + A^T y, each y_i in turn makes a Newton step, and t falls from round to round.
    Without softening, coordinate ascent would stop short of the maximum. The softened minimum is at
    x = 1 / (1 + exp(r / t)), for which violated cuts are sought (as column generation does with the
    average of a subgradient method; Barahona and Anbil, 2000).

    Args:
        cost: Symmetric, of magnitude 1.
        conflict: Pairs that may not be together.
        deadline: Time of ``time.perf_counter`` at which to stop.
        target: A bound that is good enough.
    """
    n, variables = len(cost), PairVariables(conflict)
    value = variables.vector(cost)
    cuts, y = Cuts.none(), np.zeros(0)
    best, softness = Ascent(-np.inf, np.zeros((n, n)), cuts), SOFTEST
    history: list[float] = []
    while True:
        rows = variables.rows(cuts)
        if time.perf_counter() < deadline:
            reduced = value + rows.T @ y
            _sweep(rows.indptr, rows.indices, rows.data, y, reduced, softness, SWEEPS)
        bound, reduced = lagrangian_bound(value, rows, y)
        if bound > best.bound:
            best = Ascent(bound, variables.matrix(reduced), cuts.select(y > SMALL))
        history.append(best.bound)
        settled = softness <= HARDEST and len(history) > ROUNDS
        done = settled and history[-1] - history[-1 - ROUNDS] <= LEAST_GAIN * abs(history[-1])
        if done or bound >= target or time.perf_counter() >= deadline:
            return best
        x = 1 / (1 + np.exp(np.clip(reduced / softness, -50, 50)))  # e^50: far from overflow
        keep = y > SMALL
        fresh = separate(variables.matrix(x), VIOLATION, STARTS * n, STARTS)
        cuts, y = cuts.select(keep).joined(fresh), np.concatenate([y[keep], np.zeros(len(fresh))])
        softness = max(softness * SOFTENING, HARDEST)


@compiled
def _sweep(start, variable, coefficient, y, reduced, softness, sweeps):
    """Newton steps on one multiplier after the other, of at most twice the softness.

    Where the sigmoid is flat the curvature is almost 0 and the Newton step too long: a thousandth
    is added to it. Beyond exp(30) the sigmoid is 0 or 1 to 13 digits.
    """
    for _ in range(sweeps):
        for i in range(len(y)):
            gradient, curvature = -1.0, 1e-3
            for k in range(start[i], start[i + 1]):
                t = reduced[variable[k]] / softness
                if t < -30.0:
                    x = 1.0
                elif t > 30.0:
                    x = 0.0
                else:
                    x = 1.0 / (1.0 + np.exp(t))
                gradient += coefficient[k] * x
                curvature += x * (1.0 - x)
            step = softness * min(max(gradient / curvature, -2.0), 2.0)
            step = max(step, -y[i])
            if step != 0.0:
                y[i] += step
                for k in range(start[i], start[i + 1]):
                    reduced[variable[k]] += coefficient[k] * step
