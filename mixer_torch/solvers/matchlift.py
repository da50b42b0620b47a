"""MatchLift: joint matching as a semidefinite program with non-negativity, by ADMM."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from mixer_torch.association import Status
from mixer_torch.solvers.eigen import eigh
from mixer_torch.solvers.problem import Problem, Solution, Solver
from mixer_torch.solvers.synchronization import (
    bounded_universe,
    check_evidence,
    check_stopping,
    check_universe,
    evidence_matrix,
    greedy_rounding,
    universe_size,
)


class MatchLift(Solver):
    """The semidefinite relaxation of joint partial matching, rounded greedily.

        minimise  sum_ab (λ − W_ab) X_ab  over the pairs (a, b) across views
        subject to  X_aa = 1;  X_ab = 0 for a, b of one view;  X ≥ 0;
                    [ k  1ᵀ ]
                    [ 1  X  ] ⪰ 0       with k the number of objects

    It is solved by the alternating direction method of multipliers between the cone and the
    entrywise constraints, then rounded as the authors do: an observation takes from each other
    view the one with the largest X_ab above 0.5. Labels are always feasible.

    Needs k: estimated by :func:`~mixer_torch.solvers.synchronization.universe_size` from the
    matches unless given. Soft scores: with the default, λ = 0.5 and the scores themselves as W,
    a pair costs 0.5 − score, so the objective is half of MIXER's for one modality and a pair with
    nothing to say is free. The publication takes matches and λ = sqrt(|E|) / 2n for |E| pairs of
    views with a match out of n views: ``MatchLift(evidence="match", sparsity=None)``.

    An iteration takes an eigendecomposition of order m + 1; memory is quadratic in m.

    Source: Chen, Guibas and Huang, Near-optimal joint object matching via convex relaxation, ICML
    2014.

    Args:
        universe: The number of objects k (at least that in the largest view), None to estimate it.
        evidence: What scores become; :mod:`mixer_torch.solvers.synchronization` has the kinds.
        sparsity: λ, None for the publication's value.
        max_iterations: Iterations at most; where they run out, the status says so.
        tolerance: Primal and dual residuals to stop at, relative to the size of the iterates.
    """

    def __init__(
        self,
        universe: int | None = None,
        evidence: str = "score",
        sparsity: float | None = 0.5,
        max_iterations: int = 1000,
        tolerance: float = 1e-3,
    ) -> None:
        check_stopping(max_iterations, tolerance)
        self.universe = check_universe(universe)
        self.evidence = check_evidence(evidence)
        self.sparsity = sparsity
        self.max_iterations = max_iterations
        self.tolerance = tolerance

    def run(self, problem: Problem) -> Solution:
        weight, view = evidence_matrix(problem, self.evidence), problem.view
        matches = evidence_matrix(problem, "match")
        size = bounded_universe(self.universe or universe_size(matches, view), view)
        sparsity = map_density(matches, view) if self.sparsity is None else self.sparsity
        program = lift(sparsity - weight, view, size)
        result = solve_program(program, self.max_iterations, self.tolerance)
        labels = greedy_rounding(result.primal[1:, 1:], view)
        stats = {
            "universe": size,
            "iterations": result.iterations,
            "relaxed_objective": float((program.cost * result.primal).sum()),
            "relaxed_bound": dual_bound(program, result.dual),
        }
        converged = result.iterations < self.max_iterations
        return Solution(Status.CONVERGED if converged else Status.ROUNDED, labels, stats=stats)


class Program(NamedTuple):
    """minimise <cost, X> over X ⪰ 0 with X = value where fixed, and 0 ≤ X ≤ 1 elsewhere.

    X ≤ 1 follows from X ⪰ 0 and its diagonal of 1.
    """

    cost: Float[Tensor, "n n"]
    fixed: Bool[Tensor, "n n"]
    value: Float[Tensor, "n n"]


class Point(NamedTuple):
    """Where ADMM stopped: X within its bounds, a dual matrix ⪰ 0, and the iterations done."""

    primal: Float[Tensor, "n n"]
    dual: Float[Tensor, "n n"]
    iterations: int


def map_density(matches: Float[Tensor, "m m"], view: Int64[Tensor, " m"]) -> float:
    """The publication's λ = sqrt(|E|) / 2n, with |E| pairs of the n views that have a match."""
    n = int(view.max()) + 1
    a, b = view[matches.triu(1).nonzero().T]
    edges = len(torch.unique(torch.minimum(a, b) * n + torch.maximum(a, b)))
    return edges**0.5 / (2 * n)


def lift(cost: Float[Tensor, "m m"], view: Int64[Tensor, " m"], size: int) -> Program:
    """The program in m + 1 dimensions, its first row scaled by 1 / sqrt(k).

    [ 1, 1ᵀ / sqrt(k); 1 / sqrt(k), X ] ⪰ 0 says the same as with k in the corner, and has entries
    of one magnitude.
    """
    m = len(view)
    fixed = torch.ones(m + 1, m + 1, dtype=torch.bool, device=cost.device)
    fixed[1:, 1:] = view[:, None] == view
    value = cost.new_zeros(m + 1, m + 1)
    value[0, 1:] = value[1:, 0] = size**-0.5
    value.fill_diagonal_(1)
    lifted = torch.zeros_like(value)
    lifted[1:, 1:] = cost.masked_fill(fixed[1:, 1:], 0)
    return Program(lifted, fixed, value)


def solve_program(program: Program, max_iterations: int, tolerance: float) -> Point:
    """ADMM in two blocks: the entrywise constraints, and the cone.

    Steps are over-relaxed by 1.6 (Boyd et al. 2011, 3.4.3: 1.5 to 1.8). Every 10 iterations the
    step size is adapted to the two residuals (3.4.1), so that the primal one becomes nine times
    smaller than the dual one, since it is the primal matrix that is rounded. The first step size
    of 8 only changes how soon that is reached.
    """
    cost, fixed, value = program
    cone, dual, step = value, torch.zeros_like(value), 8.0
    iteration = 0
    while iteration < max_iterations:
        iteration += 1
        bounded = (cone - dual - cost / step).clamp(0, 1)
        bounded = torch.where(fixed, value, bounded)
        relaxed = 1.6 * bounded - 0.6 * cone
        previous, cone = cone, positive_part(relaxed + dual)
        dual = dual + relaxed - cone
        primal_residual = float((bounded - cone).norm() / bounded.norm())
        dual_residual = float((cone - previous).norm() / dual.norm().clamp(min=1e-12))
        if max(primal_residual, dual_residual) < tolerance:
            break
        if iteration % 10 == 0:
            ratio = 3 * (primal_residual / max(dual_residual, 1e-12)) ** 0.5
            factor = min(max(ratio, 0.5), 2.0) if not 0.5 < ratio < 2 else 1.0
            step, dual = step * factor, dual / factor
    return Point(bounded, -step * dual, iteration)


def positive_part(matrix: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """The nearest positive semidefinite matrix in the Frobenius norm."""
    values, vectors = eigh((matrix + matrix.T) / 2)
    return (vectors * values.clamp(min=0)) @ vectors.T


def dual_bound(program: Program, dual: Float[Tensor, "n n"]) -> float:
    """A lower bound of the program's objective, by weak duality, for any dual S ⪰ 0.

    <cost, X> ≥ <cost − S, X> for every X ⪰ 0, and the least value of that over the entrywise
    constraints is known in closed form.
    """
    reduced = program.cost - dual
    least = torch.where(program.fixed, reduced * program.value, reduced.clamp(max=0))
    return float(least.sum())
