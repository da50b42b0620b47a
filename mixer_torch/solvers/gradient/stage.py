"""The gradient stage: problems in, labels out, in padded batches."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.solvers.eigen import eigh
from mixer_torch.solvers.gradient.annealing import anneal
from mixer_torch.solvers.gradient.batch import LARGEST_CPU, Batch, Descent, continued
from mixer_torch.solvers.gradient.descent import descend
from mixer_torch.solvers.gradient.rounding import binary_labels, nearest_labels
from mixer_torch.solvers.one_thread import one_thread
from mixer_torch.solvers.transfer import on_host

ANNEALING = 100  # iterations


@dataclass(frozen=True)
class Relaxed:
    """What the gradient stage made of one problem.

    Args:
        labels: Feasible, on the CPU.
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
        small = batch.cost.device.type == "cpu" and batch.cost.shape[1] <= LARGEST_CPU
        with one_thread() if small else nullcontext():
            result = self.descend(batch, columns)
            labels, binary = binary_labels(result.assignment, batch)
        history = result.history.double().T / 2
        numbers = batch.mask.sum(1), binary, result.iterations, result.penalty, history
        labels, *host = on_host([labels, *numbers])
        all_numbers = zip(*(array.tolist() for array in host), strict=True)
        rough = (~host[1]).nonzero()[:, 0].tolist()
        rounded = _rounded(result.assignment, batch, host[0], rough)
        answers = []
        for i, (size, whole, iterations, penalty, values) in enumerate(all_numbers):
            label = labels[i, :size] if whole else rounded[i]
            answers.append(Relaxed(label, whole, iterations, penalty, values[:iterations]))
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
        if not left:
            return result
        open_ = (~binary_labels(result.assignment, batch)[1]).nonzero()[:, 0]
        if not len(open_):
            return result
        rest = Batch(batch.cost[open_], batch.distinctness[open_], batch.mask[open_])
        finish = self._penalised(rest, result.assignment[open_], "simplex", left)
        return continued(result, open_, finish)

    def _penalised(self, batch: Batch, start: Tensor, projection: str, limit: int) -> Descent:
        return descend(batch, start, projection=projection, max_iterations=limit, seed=self.seed)


def _rounded(
    assignment: Tensor, batch: Batch, size: Tensor, chosen: list[int]
) -> dict[int, Int64[Tensor, " m"]]:
    """The nearest feasible labels of some problems of the batch, found on the host."""
    rows = [slice(int(size[i])) for i in chosen]
    matrices = [assignment[i, row] for i, row in zip(chosen, rows, strict=True)]
    apart = [batch.distinctness[i, row, row] > 0 for i, row in zip(chosen, rows, strict=True)]
    host = on_host([*matrices, *apart])
    pairs = zip(host[: len(chosen)], host[len(chosen) :], strict=True)
    return {i: nearest_labels(*pair) for i, pair in zip(chosen, pairs, strict=True)}


def spectral_start(batch: Batch, columns: int, seed: int) -> Float[Tensor, "B m k"]:
    """Eigenvectors of Ā, from the lowest eigenvalue up, and a little noise that breaks ties."""
    cost = batch.cost
    generator = torch.Generator(device=cost.device).manual_seed(seed)
    shape = cost.shape[1], columns
    noise = torch.rand(shape, generator=generator, dtype=cost.dtype, device=cost.device)
    return eigh(cost)[1][..., :columns] + 1e-3 * noise
