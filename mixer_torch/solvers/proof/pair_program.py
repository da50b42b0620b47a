"""The linear program over pair variables, solved by HiGHS while cuts come and go."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from mixer_torch.extras import require
from mixer_torch.solvers.proof.cuts import Cuts, rows_of

TOLERANCE = 1e-9
ROUNDING = 1e-13


class Optimum(NamedTuple):
    """What a linear program says.

    Args:
        x: (V,) the optimum, or the last point where time ran out.
        bound: Proven lower bound of every clustering within the limits of the variables; inf where
            there is none.
        reduced: (V,) reduced costs that belong to the bound.
        finished: Whether the linear program was solved.
    """

    x: np.ndarray
    bound: float
    reduced: np.ndarray
    finished: bool


class PairProgram:
    """Linear relaxation of correlation clustering.

        minimise  sum of cost_e x_e   subject to  0 <= x <= 1 and the cuts that were added

    with one variable for each pair of nodes that may be together. Bounds do not trust the solver's
    tolerances: with multipliers y >= 0 of the cuts A x <= 1, whatever they are,

        min_x sum_e min(r_e low_e, r_e high_e) - sum y,     r = cost + A^T y

    bounds the optimum from below, and it is this that is told, in float64 and rounded down.

    Args:
        cost: (n, n) symmetric, of magnitude 1 or so.
        apart: (n, n) pairs that may not be together.
    """

    def __init__(self, cost: Float64[np.ndarray, "n n"], apart: Bool[np.ndarray, "n n"]) -> None:
        highspy = require("highspy", extra="exact")
        n = len(cost)
        self.first, self.second = np.nonzero(np.triu(~apart, 1))
        self.cost = cost[self.first, self.second]
        self.pair_index = np.full((n, n), -1, np.int64)
        self.pair_index[self.first, self.second] = np.arange(len(self.cost))
        self.pair_index[self.second, self.first] = np.arange(len(self.cost))
        self._start = np.zeros(1, np.int64)
        self._variable, self._coefficient = np.zeros(0, np.int64), np.zeros(0)
        self._dual = np.zeros(0)
        self._low, self._high = np.zeros(len(self.cost)), np.ones(len(self.cost))
        self._highs = highspy.Highs()
        self._statuses = highspy.HighsModelStatus
        for option, value in (
            ("output_flag", False),
            ("threads", 1),
            ("dual_feasibility_tolerance", TOLERANCE),
            ("primal_feasibility_tolerance", TOLERANCE),
        ):
            self._highs.setOptionValue(option, value)
        none = np.zeros(0, np.int32)
        self._highs.addCols(
            len(self.cost), self.cost, self._low, self._high, 0, none, none, np.zeros(0)
        )

    @property
    def num_cuts(self) -> int:
        """How many rows there are."""
        return len(self._start) - 1

    def limit(self, low: np.ndarray, high: np.ndarray) -> None:
        """Set the limits of all variables."""
        self._low, self._high = low.copy(), high.copy()
        self._highs.changeColsBounds(len(low), np.arange(len(low), dtype=np.int32), low, high)

    def add(self, cuts: Cuts) -> None:
        """Add cuts as rows."""
        start, variable, coefficient = rows_of(
            self.pair_index, cuts.centre, cuts.start, cuts.member
        )
        count = len(cuts)
        self._highs.addRows(
            count,
            np.full(count, -np.inf),
            np.ones(count),
            len(variable),
            start[:-1].astype(np.int32),
            variable.astype(np.int32),
            coefficient,
        )
        self._start = np.concatenate([self._start, start[1:] + self._start[-1]])
        self._variable = np.concatenate([self._variable, variable])
        self._coefficient = np.concatenate([self._coefficient, coefficient])

    def drop_slack(self) -> None:
        """Remove the rows that did not bind when the program was last solved."""
        binds = self._dual > TOLERANCE
        slack = np.flatnonzero(~binds)
        if not len(slack):
            return
        self._highs.deleteRows(len(slack), slack.astype(np.int32))
        size = np.diff(self._start)
        keep = np.repeat(binds, size)
        self._variable, self._coefficient = self._variable[keep], self._coefficient[keep]
        self._start = np.concatenate([[0], np.cumsum(size[binds])]).astype(np.int64)
        self._dual = self._dual[binds]

    def solve(self, deadline: float = np.inf) -> Optimum:
        """Solve from the last basis on, until a time of ``time.perf_counter``."""
        seconds = max(deadline - time.perf_counter(), 0.0)
        self._highs.setOptionValue("time_limit", self._highs.getRunTime() + seconds)
        self._highs.run()
        status = self._highs.getModelStatus()
        solution = self._highs.getSolution()
        x = np.clip(np.array(solution.col_value), self._low, self._high)
        if status == self._statuses.kInfeasible:
            return Optimum(x, np.inf, np.zeros_like(x), True)
        dual = np.array(solution.row_dual)
        if len(dual) != self.num_cuts or not np.isfinite(dual).all():
            dual = np.zeros(self.num_cuts)
        self._dual = np.maximum(-dual, 0.0)
        bound, reduced = self._bound()
        return Optimum(x, bound, reduced, status == self._statuses.kOptimal)

    def matrix(self, x: np.ndarray) -> np.ndarray:
        """(n, n) symmetric matrix of the variables, 0 where there is none."""
        full = np.zeros(self.pair_index.shape)
        full[self.first, self.second] = x
        full[self.second, self.first] = x
        return full

    def _bound(self) -> tuple[float, np.ndarray]:
        multiplier = np.repeat(self._dual, np.diff(self._start))
        change = np.bincount(
            self._variable, self._coefficient * multiplier, minlength=len(self.cost)
        )
        reduced = self.cost + change
        least = np.minimum(reduced * self._low, reduced * self._high).sum()
        magnitude = np.abs(self.cost).sum() + multiplier.sum() + self._dual.sum()
        return float(least - self._dual.sum() - ROUNDING * magnitude), reduced
