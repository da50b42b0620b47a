"""The linear program over pair variables, solved by HiGHS while cuts come and go."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64
from scipy.sparse import csr_array, vstack

from mixer_torch.extras import require
from mixer_torch.solvers.proof.cuts import Cuts, PairVariables, lagrangian_bound

TOLERANCE = 1e-9  # of HiGHS, which allows no less than 1e-10; a multiplier below it counts as 0


class Optimum(NamedTuple):
    """The result of a linear program."""

    x: np.ndarray  # (V,) the optimum, or the last point where time ran out
    bound: float  # of every clustering within the limits of the variables; inf if there is none
    reduced: np.ndarray  # (V,) reduced costs that belong to the bound
    finished: bool  # whether the linear program was solved


class PairProgram:
    """Linear relaxation of correlation clustering.

        minimise  sum of cost_e x_e   subject to  0 <= x <= 1 and the cuts that were added

    with one variable for each pair of nodes that may be together. Bounds do not rely on the
    solver's tolerances: they are computed from its multipliers by :func:`lagrangian_bound`.

    Args:
        cost: (n, n) symmetric, of magnitude 1 or so.
        conflict: (n, n) pairs that may not be together.
    """

    def __init__(self, cost: Float64[np.ndarray, "n n"], conflict: Bool[np.ndarray, "n n"]) -> None:
        highspy = require("highspy", extra="exact")
        self.variables = PairVariables(conflict)
        self.cost = self.variables.vector(cost)
        count = len(self.cost)
        self._rows, self._dual = csr_array((0, count)), np.zeros(0)
        self._low, self._high = np.zeros(count), np.ones(count)
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
        self._highs.addCols(count, self.cost, self._low, self._high, 0, none, none, np.zeros(0))

    def limit(self, low: np.ndarray, high: np.ndarray) -> None:
        """Set the limits of all variables."""
        self._low, self._high = low.copy(), high.copy()
        self._highs.changeColsBounds(len(low), np.arange(len(low), dtype=np.int32), low, high)

    def add(self, cuts: Cuts) -> None:
        """Add cuts as rows."""
        rows, count = self.variables.rows(cuts), len(cuts)
        start, variable = rows.indptr[:-1].astype(np.int32), rows.indices.astype(np.int32)
        none, ones = np.full(count, -np.inf), np.ones(count)
        self._highs.addRows(count, none, ones, rows.nnz, start, variable, rows.data)
        self._rows = vstack([self._rows, rows], format="csr")

    def drop_slack(self) -> None:
        """Remove the rows that did not bind when the program was last solved."""
        binds = self._dual > TOLERANCE
        slack = np.flatnonzero(~binds)
        if len(slack):
            self._highs.deleteRows(len(slack), slack.astype(np.int32))
            self._rows, self._dual = self._rows[binds], self._dual[binds]

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
        if len(dual) != self._rows.shape[0] or not np.isfinite(dual).all():
            dual = np.zeros(self._rows.shape[0])
        self._dual = np.maximum(-dual, 0.0)
        bound, reduced = lagrangian_bound(self.cost, self._rows, self._dual, self._low, self._high)
        return Optimum(x, bound, reduced, status == self._statuses.kOptimal)
