"""MIXER: projected gradient descent on the relaxed problem of the paper."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from mixer_torch.association import Status
from mixer_torch.solvers.base import Problem, Solution, Solver, is_distinct
from mixer_torch.solvers.descent import PROJECTIONS, descend
from mixer_torch.solvers.relaxation import distinctness_matrix, is_binary
from mixer_torch.solvers.rounding import nearest_labels


class Mixer(Solver):
    """Multimodal, multiway association by the continuous relaxation of the paper.

    Args:
        max_iterations: Steps of the gradient descent at most.
        projection: Constraint on the rows of U: "row_sum_at_most_one", as in the paper, or
            "simplex" (row sum 1), as in the authors' later version.
        seed: Of the small disturbance that breaks ties at the start.
    """

    def __init__(
        self,
        max_iterations: int = 1000,
        projection: Literal["row_sum_at_most_one", "simplex"] = "simplex",
        seed: int = 0,
    ) -> None:
        if max_iterations < 1:
            raise ValueError(f"max_iterations: expected at least 1, got {max_iterations}")
        if projection not in PROJECTIONS:
            raise ValueError(
                f"projection: expected one of {', '.join(PROJECTIONS)}, got {projection!r}"
            )
        self.max_iterations = max_iterations
        self.projection = projection
        self.seed = seed

    def run(self, problem: Problem) -> Solution:
        cost = problem.dense_cost()[None]
        scale = cost.abs().amax()
        cost = cost / torch.where(scale > 0, scale, torch.ones_like(scale))
        distinctness = distinctness_matrix(problem.view, cost.dtype)[None]
        mask = torch.ones_like(problem.view, dtype=torch.bool)[None]
        result = descend(
            cost,
            distinctness,
            mask,
            self._start(cost),
            projection=self.projection,
            max_iterations=self.max_iterations,
        )
        assignment = result.assignment[0]
        labels = assignment.argmax(1)
        binary = bool(is_binary(assignment)) and is_distinct(labels, problem.view)
        stats = {
            "iterations": int(result.iterations[0]),
            "history": (result.history[:, 0] * scale).tolist(),
            "binary_without_rounding": binary,
            "penalty": float(result.penalty[0]),
            "violation": float(result.violation[0]),
        }
        if binary:
            return Solution(Status.CONVERGED, labels=labels, stats=stats)
        return Solution(Status.ROUNDED, nearest_labels(assignment, problem.view), stats=stats)

    def _start(self, cost: Tensor) -> Tensor:
        """Eigenvectors of Ā, from the lowest eigenvalue up, projected row by row."""
        generator = torch.Generator(device=cost.device).manual_seed(self.seed)
        noise = torch.rand(cost.shape, generator=generator, dtype=cost.dtype, device=cost.device)
        vectors = torch.linalg.eigh(cost).eigenvectors
        return PROJECTIONS[self.projection](vectors + 1e-3 * noise)
