"""The gradient stage: problems in, labels out, in padded batches."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.solvers.eigen import eigh
from mixer_torch.solvers.gradient.annealing import anneal
from mixer_torch.solvers.gradient.batch import Batch, Descent, continued
from mixer_torch.solvers.gradient.descent import descend
from mixer_torch.solvers.gradient.rounding import binary_labels, nearest_labels

ANNEALING = 100  # iterations


@dataclass(frozen=True)
class Relaxed:
    """What the gradient stage made of one problem.

    Args:
        labels: Feasible.
        binary: Whether U was binary and feasible, so that nothing had to be rounded.
        iterations: Steps.
        penalty: The last coefficient of the penalties, relative to the scale of the costs.
        history: Relaxed objective at each step, in units of the objective.
    """

    labels: Int64[Tensor, " m"]
    binary: bool
    iterations: int
    penalty: float
    history: list[float]


@dataclass(frozen=True)
class GradientStage:
    """Which descent, and how.

    Args:
        schedule: "penalty", the paper's, or "anneal".
        projection: Of the paper's schedule: "row_sum_at_most_one" or "simplex".
        max_iterations: Steps at most. Annealing takes 100 of them; problems that are not binary
            then, such as those in which nothing attracts, go on from there by the paper's schedule.
        seed: Of the small disturbances.
        precision: Of matrix products when annealing.
    """

    schedule: str
    projection: str
    max_iterations: int
    seed: int
    precision: str

    def run(self, batch: Batch, columns: int) -> list[Relaxed]:
        """Solve the problems of a batch, with at most so many clusters in each."""
        result = self.descend(batch, columns)
        labels, binary = binary_labels(result.assignment, batch)
        history = (result.history.double().T / 2).tolist()
        size = batch.mask.sum(1).tolist()
        numbers = zip(
            binary.tolist(), result.iterations.tolist(), result.penalty.tolist(), strict=True
        )
        answers = []
        for i, (whole, iterations, penalty) in enumerate(numbers):
            label = labels[i, : size[i]]
            if not whole:
                apart = batch.distinctness[i, : size[i], : size[i]] > 0
                label = nearest_labels(result.assignment[i, : size[i]], apart)
            answers.append(Relaxed(label, whole, iterations, penalty, history[i][:iterations]))
        return answers

    def descend(self, batch: Batch, columns: int) -> Descent:
        """The relaxed problems of a batch, with so many columns."""
        if self.schedule == "penalty":
            start = spectral_start(batch, columns, self.seed)
            return self._penalised(batch, start, self.projection, self.max_iterations)
        iterations = min(self.max_iterations, ANNEALING)
        result = anneal(
            batch, columns, iterations=iterations, seed=self.seed, precision=self.precision
        )
        left = self.max_iterations - iterations
        open_ = ~binary_labels(result.assignment, batch)[1]
        if not left or not bool(open_.any()):
            return result
        rest = Batch(batch.cost[open_], batch.distinctness[open_], batch.mask[open_])
        finish = self._penalised(rest, result.assignment[open_], "simplex", left)
        return continued(result, open_, finish)

    def _penalised(self, batch: Batch, start: Tensor, projection: str, limit: int) -> Descent:
        return descend(batch, start, projection=projection, max_iterations=limit, seed=self.seed)


def spectral_start(batch: Batch, columns: int, seed: int) -> Float[Tensor, "B m k"]:
    """Eigenvectors of Ā, from the lowest eigenvalue up, and a little noise that breaks ties."""
    cost = batch.cost
    generator = torch.Generator(device=cost.device).manual_seed(seed)
    shape = cost.shape[1], columns
    noise = torch.rand(shape, generator=generator, dtype=cost.dtype, device=cost.device)
    return eigh(cost)[1][..., :columns] + 1e-3 * noise
