"""The gradient stage: problems in, labels out, in padded batches."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.solvers.annealing import anneal
from mixer_torch.solvers.base import Problem
from mixer_torch.solvers.batch import Batch, Descent, buckets
from mixer_torch.solvers.descent import descend
from mixer_torch.solvers.rounding import binary_labels, nearest_labels


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
        max_iterations: Steps at most.
        seed: Of the small disturbances.
        precision: Of matrix products when annealing.
    """

    schedule: str
    projection: str
    max_iterations: int
    seed: int
    precision: str

    def run(
        self, problems: Sequence[Problem], columns: Sequence[int] | None = None
    ) -> Iterator[tuple[int, Relaxed]]:
        """Solve problems in padded batches; yields index and result, batch by batch.

        Args:
            problems: With at least one observation each.
            columns: How many clusters to allow for in each, if fewer than its observations.
        """
        for bucket in buckets(problems):
            chosen = [problems[i] for i in bucket]
            m = max(len(problem) for problem in chosen)
            k = m if columns is None else min(m, max(columns[i] for i in bucket))
            batch = Batch.of(chosen)
            yield from zip(bucket, _read(chosen, batch, self.descend(batch, k)), strict=True)

    def descend(self, batch: Batch, columns: int) -> Descent:
        """The relaxed problems of a batch, with so many columns."""
        if self.schedule == "anneal":
            return anneal(
                batch,
                columns,
                iterations=self.max_iterations,
                seed=self.seed,
                precision=self.precision,
            )
        start = spectral_start(batch, columns, self.seed)
        return descend(
            batch,
            start,
            projection=self.projection,
            max_iterations=self.max_iterations,
            seed=self.seed,
        )


def spectral_start(batch: Batch, columns: int, seed: int) -> Float[Tensor, "B m k"]:
    """Eigenvectors of Ā, from the lowest eigenvalue up, and a little noise that breaks ties."""
    cost = batch.cost
    generator = torch.Generator(device=cost.device).manual_seed(seed)
    shape = cost.shape[1], columns
    noise = torch.rand(shape, generator=generator, dtype=cost.dtype, device=cost.device)
    return torch.linalg.eigh(cost).eigenvectors[..., :columns] + 1e-3 * noise


def _read(problems: Sequence[Problem], batch: Batch, result: Descent) -> Iterator[Relaxed]:
    labels, binary = binary_labels(result.assignment, batch)
    history = (result.history.double().T / 2).tolist()
    numbers = zip(binary.tolist(), result.iterations.tolist(), result.penalty.tolist(), strict=True)
    for i, (problem, (is_binary, iterations, penalty)) in enumerate(
        zip(problems, numbers, strict=True)
    ):
        m = len(problem)
        label = labels[i, :m]
        if not is_binary:
            label = nearest_labels(result.assignment[i, :m], problem.apart())
        values = [value for value in history[i][:iterations] if math.isfinite(value)]
        yield Relaxed(label, is_binary, iterations, penalty, values)
