"""A lower bound without a linear program: ascent in the multipliers of the cuts."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.proof.cuts import Cuts, rows_of, separate

SOFTEST, HARDEST, HARDENING = 0.3, 0.003, 0.92
SWEEPS = 10  # over all cuts, between two searches for new ones
PATIENCE = 10  # rounds over which a settled ascent has to gain
SMALL = 1e-6
VIOLATION = 0.02
ROUNDING = 1e-13


class Ascent(NamedTuple):
    """What dual ascent proved.

    Args:
        bound: No clustering costs less.
        reduced: (n, n) reduced costs; a clustering that departs from their sign at a pair costs
            bound + |reduced| or more. 0 for pairs that may not be together.
        cuts: Those with a multiplier above 0, which a linear program would start with.
    """

    bound: float
    reduced: np.ndarray
    cuts: Cuts


def ascend(
    cost: Float64[np.ndarray, "n n"],
    apart: Bool[np.ndarray, "n n"],
    deadline: float,
    target: float = np.inf,
) -> Ascent:
    """Maximise the Lagrangian bound of the 2-partition inequalities, over the inequalities too.

        L(y) = sum_e min(0, cost_e + (A^T y)_e) - sum y,      y >= 0, one for each cut A x <= 1

    L(y) bounds the optimum for any y, so it is only evaluated carefully, and is maximised in
    whatever way is fast: the minimum is softened to -t log(1 + exp(-r / t)), each y_i in turn makes
    a Newton step, and t falls from round to round. Softened minima have the minimiser
    x = 1 / (1 + exp(r / t)), in which broken inequalities are looked for (as column generation does
    with the average of a subgradient method; Barahona and Anbil, 2000). Without softening,
    coordinate ascent would get stuck.

    Args:
        cost: Symmetric, of magnitude 1.
        apart: Pairs that may not be together.
        deadline: Time of ``time.perf_counter`` at which to stop.
        target: A bound that is good enough.
    """
    n = len(cost)
    first, second = np.nonzero(np.triu(~apart, 1))
    variables = len(first)
    index = np.full((n, n), -1, np.int64)
    index[first, second] = index[second, first] = np.arange(variables)
    value = cost[first, second]
    cuts, y = Cuts.none(), np.zeros(0)
    best, softness = Ascent(-np.inf, np.zeros((n, n)), cuts), SOFTEST
    history: list[float] = []
    while True:
        start, variable, coefficient = rows_of(index, cuts.centre, cuts.start, cuts.member)
        reduced = value + _weights(start, variable, coefficient, y, variables)
        if time.perf_counter() < deadline:
            _sweep(start, variable, coefficient, y, reduced, softness, SWEEPS)
            reduced = value + _weights(start, variable, coefficient, y, variables)
        bound = _bound(value, reduced, start, y)
        if bound > best.bound:
            best = Ascent(bound, _square(n, first, second, reduced), cuts.select(y > SMALL))
        history.append(best.bound)
        settled = softness <= HARDEST and len(history) > PATIENCE
        done = settled and history[-1] - history[-1 - PATIENCE] <= 1e-4 * abs(history[-1])
        if done or bound >= target or time.perf_counter() >= deadline:
            return best
        x = 1 / (1 + np.exp(np.clip(reduced / softness, -50, 50)))
        keep = y > SMALL
        fresh = separate(_square(n, first, second, x), VIOLATION, 40 * n, starts=40)
        cuts, y = cuts.select(keep).joined(fresh), np.concatenate([y[keep], np.zeros(len(fresh))])
        softness = max(softness * HARDENING, HARDEST)


def _bound(value: np.ndarray, reduced: np.ndarray, start: np.ndarray, y: np.ndarray) -> float:
    """L(y), rounded down by more than the sums may have lost."""
    magnitude = np.abs(value).sum() + (y * (1 + np.diff(start))).sum()
    return float(np.minimum(reduced, 0).sum() - y.sum() - ROUNDING * magnitude)


def _weights(
    start: np.ndarray, variable: np.ndarray, coefficient: np.ndarray, y: np.ndarray, count: int
) -> np.ndarray:
    """A^T y."""
    return np.bincount(variable, coefficient * np.repeat(y, np.diff(start)), minlength=count)


def _square(n: int, first: np.ndarray, second: np.ndarray, x: np.ndarray) -> np.ndarray:
    full = np.zeros((n, n))
    full[first, second] = full[second, first] = x
    return full


@compiled
def _sweep(start, variable, coefficient, y, reduced, softness, sweeps):  # type: ignore[no-untyped-def]
    """Newton steps on one multiplier after the other, of at most twice the softness."""
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
