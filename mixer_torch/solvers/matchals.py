"""MatchALS: joint matching as low-rank recovery, by alternating least squares."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.pairs import within_view
from mixer_torch.solvers.problem import Problem, Solution, Solver
from mixer_torch.solvers.synchronization import (
    check_evidence,
    check_stopping,
    evidence_matrix,
    solution_of_links,
    universe_size,
)


class MatchALS(Solver):
    """Matches of low rank, in factored form.

        minimise  −<W, X> + β sum X + α ‖X‖_*
        subject to  X_aa = 1;  X_ab = 0 for a, b of one view;  0 ≤ X ≤ 1

    With the nuclear norm written as the least (‖A‖² + ‖B‖²) / 2 over X = A Bᵀ, the alternating
    direction method of multipliers needs only least squares of a small rank. A pair is a match if
    X_ab > 0.5, as in the publication, which **need not be consistent**: there are labels where the
    matches are, and only links where they are not.

    Needs a rank above the number of objects. Soft scores: see ``evidence``.

    Source: Zhou, Zhu and Daniilidis, Multi-image matching via fast alternating minimization, ICCV
    2015.

    Args:
        rank: Columns of A and B; twice the estimated number of objects if None, as the authors
            of CLEAR set it in their comparison.
        evidence: What scores become; :mod:`mixer_torch.solvers.synchronization` has the kinds.
        nuclear: α, the authors' default.
        sparsity: β, the authors' default.
        max_iterations: Iterations at most, the authors' default; the stats say how many it took.
        tolerance: Primal and dual residuals to stop at, for each observation; the authors'
            default.
        seed: Of the random start.
    """

    def __init__(
        self,
        rank: int | None = None,
        evidence: str = "match",
        nuclear: float = 50.0,
        sparsity: float = 0.1,
        max_iterations: int = 1000,
        tolerance: float = 5e-4,
        seed: int = 0,
    ) -> None:
        if rank is not None and rank < 1:
            raise ValueError(f"rank: expected an integer >= 1 or None, got {rank}")
        check_stopping(max_iterations, tolerance)
        self.rank = rank
        self.evidence = check_evidence(evidence)
        self.nuclear = nuclear
        self.sparsity = sparsity
        self.max_iterations = max_iterations
        self.tolerance = tolerance
        self.seed = seed

    def run(self, problem: Problem) -> Solution:
        weight = evidence_matrix(problem, self.evidence)
        rank = min(self.rank or 2 * universe_size(weight, problem.view), len(problem))
        generator = torch.Generator().manual_seed(self.seed)
        start = torch.rand(len(problem), rank, generator=generator).to(weight)
        matrix, iterations = low_rank_matches(
            weight,
            problem.view,
            start,
            self.nuclear,
            self.sparsity,
            self.max_iterations,
            self.tolerance,
        )
        links = (matrix > 0.5).triu(1).nonzero().T
        links = links[:, ~within_view(problem.view, links)]
        return solution_of_links(problem, links, rank=rank, iterations=iterations)


def low_rank_matches(
    weight: Float[Tensor, "m m"],
    view: Int64[Tensor, " m"],
    factor: Float[Tensor, "m k"],
    nuclear: float,
    sparsity: float,
    max_iterations: int,
    tolerance: float,
) -> tuple[Float[Tensor, "m m"], int]:
    """The program of :class:`MatchALS` from a start A = factor: X, and the iterations it took."""
    m, step, iteration = len(view), 64.0, 0  # the authors' first step
    same_view = view[:, None] == view
    low_rank, bounded, dual = weight, weight, torch.zeros_like(weight)
    while iteration < max_iterations:
        iteration += 1
        previous = low_rank
        target = bounded - (dual - weight + sparsity) / step
        other = least_squares(factor, target.T, nuclear / step)
        factor = least_squares(other, target, nuclear / step)
        low_rank = factor @ other.T
        bounded = (low_rank + dual / step).masked_fill(same_view, 0).fill_diagonal_(1).clamp(0, 1)
        dual = dual + step * (low_rank - bounded)
        primal = float((low_rank - bounded).norm()) / m
        change = step * float((low_rank - previous).norm()) / m
        if max(primal, change) < tolerance:
            break
        # the residuals are kept within a factor of ten (Boyd et al. 2011, 3.4.1)
        step *= 2.0 if primal > 10 * change else 0.5 if change > 10 * primal else 1.0
    return (low_rank + low_rank.T) / 2, iteration


def least_squares(
    factor: Float[Tensor, "m k"], target: Float[Tensor, "m m"], ridge: float
) -> Float[Tensor, "m k"]:
    """The B that minimises ‖A Bᵀ − targetᵀ‖² + ridge ‖B‖², for a factor A."""
    gram = factor.T @ factor + ridge * torch.eye(factor.shape[1]).to(factor)
    return torch.linalg.solve(gram, (target @ factor).T).T
