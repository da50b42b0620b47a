"""The gradient stage: problems in, labels out, in padded batches."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass

from jaxtyping import Int64
from torch import Tensor

from mixer_torch.solvers.gradient.batch import LARGEST_CPU, Batch
from mixer_torch.solvers.gradient.rounding import binary_labels, nearest_labels
from mixer_torch.solvers.gradient.schedule import Schedule
from mixer_torch.solvers.one_thread import one_thread
from mixer_torch.solvers.transfer import on_host


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
    """The relaxed problem, from batches of matrices to labels.

    Args:
        schedule: How the relaxation becomes binary.
        max_iterations: Steps at most.
        seed: Of all random draws.
    """

    schedule: Schedule
    max_iterations: int
    seed: int

    def run(self, batch: Batch, columns: int) -> list[Relaxed]:
        """Solve the problems of a batch, with at most so many clusters in each."""
        small = batch.cost.device.type == "cpu" and batch.cost.shape[1] <= LARGEST_CPU
        with one_thread() if small else nullcontext():
            result = self.schedule.descend(batch, columns, self.max_iterations, self.seed)
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
