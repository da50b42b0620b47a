"""The paper's algorithm: projected gradient descent with Armijo backtracking and increasing d."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from mixer_torch.solvers.eigen import eigh
from mixer_torch.solvers.gradient.batch import Batch, Descent
from mixer_torch.solvers.gradient.projection import project_rows
from mixer_torch.solvers.gradient.relaxation import Evaluated, evaluate
from mixer_torch.solvers.gradient.schedule import Schedule, choice

# Armijo's rule: the share of the predicted decrease that a step must reach, which is 1e-4 by
# convention (Nocedal and Wright, Numerical Optimization, section 3.1), and the factors of the step
# size where it did not and where it did, set by hand.
ARMIJO = 1e-4
SHRINK, GROW = 0.25, 2.0
# d at the start, relative to where cost and penalties balance (as in the authors' later version),
# and the bounds of that balance. The bounds are relative to the largest cost, which is 1 here.
FIRST = 0.1
LEAST_BALANCE, LARGEST_BALANCE = 1e-3, 1.0
# The rest is set by hand.
LEVEL_ITERATIONS = 50  # trial steps at most before d is doubled
TOLERANCE = 1e-4  # movement of an entry, and violation an observation, that count as none
DISTURBANCE = 0.05  # of U, where a level has ended at a point that breaks a constraint
BLOCK = 10  # iterations between two looks by the host whether all problems are finished
START_NOISE = 1e-3  # breaks ties between eigenvectors at the start

Projection = Literal["row_sum_at_most_one", "simplex"]


@dataclass(frozen=True)
class PenaltyDoubling(Schedule):
    """The schedule of the paper: F_d is minimised for one d after the other, each twice the last.

    Args:
        projection: Constraint on the rows of U: "row_sum_at_most_one", as in the paper, or
            "simplex" (row sums 1), as in the authors' later version.

    Raises:
        ValueError: There is no such projection.
    """

    projection: str = "row_sum_at_most_one"

    def __post_init__(self) -> None:
        choice("projection", self.projection, Projection)

    def descend(self, batch: Batch, columns: int, max_iterations: int, seed: int) -> Descent:
        start = spectral_start(batch, columns, seed)
        return self.descend_from(batch, start, max_iterations, seed)

    def descend_from(
        self, batch: Batch, start: Float[Tensor, "B m k"], max_iterations: int, seed: int
    ) -> Descent:
        """The descent from a given U."""
        return penalised_descent(
            batch, start, projection=self.projection, max_iterations=max_iterations, seed=seed
        )


def spectral_start(batch: Batch, columns: int, seed: int) -> Float[Tensor, "B m k"]:
    """Eigenvectors of Ā, from the lowest eigenvalue up, and a little noise that breaks ties."""
    cost = batch.cost
    generator = torch.Generator(device=cost.device).manual_seed(seed)
    shape = cost.shape[1], columns
    noise = torch.rand(shape, generator=generator, dtype=cost.dtype, device=cost.device)
    return eigh(cost)[1][..., :columns] + START_NOISE * noise


def penalised_descent(
    batch: Batch,
    start: Float[Tensor, "B m k"],
    *,
    projection: str = "row_sum_at_most_one",
    max_iterations: int = 1000,
    seed: int = 0,
) -> Descent:
    """Minimise F_d for one d after the other, each from where the last one ended.

    F_d, its gradient and its constraints are those of
    :mod:`mixer_torch.solvers.gradient.relaxation`, with costs divided by the largest one. d starts
    below where cost and penalties balance (:func:`first_penalty`). A level, which is the time of
    one d, ends where a step moves no entry any more. A problem is finished if both penalties vanish
    there; otherwise its d is doubled and U is disturbed a little, because rows may sit at a saddle
    point, in equal parts in several columns, or at a vertex next to a lower one. From d = m + 1 on
    the row sums are 1, as they are in the limit and in the authors' later version: sums <= 1
    approach it slowly. Each problem has its own step size and its own d, and stays as it is once it
    is finished.

    Within a block of iterations the host waits for nothing (:func:`_block`); between two blocks it
    waits once, to see whether all problems are finished. To look at the block before instead would
    spare that, which is some microseconds, for a whole block more at the end of every descent.

    Args:
        batch: The problems.
        start: U to begin with.
        projection: "row_sum_at_most_one", as in the paper, or "simplex".
        max_iterations: Trial steps in all.
        seed: Of the disturbances.
    """
    scale = batch.cost.abs().amax((1, 2))
    scale = torch.where(scale > 0, scale, 1.0)
    cost = batch.cost / scale[:, None, None]
    matrices = torch.cat([cost, batch.distinctness], 1)
    loose = torch.full_like(scale, projection == "row_sum_at_most_one", dtype=torch.bool)
    point = evaluate(project_rows(start.clone(), batch.mask, loose), matrices)
    penalty = first_penalty(point.assignment, cost, batch.distinctness).clamp(
        LEAST_BALANCE, LARGEST_BALANCE
    )
    size = batch.mask.sum(1)
    levels = _Levels(FIRST * penalty, 2 * cost.abs().sum(2).amax(1), size, loose)
    generator = torch.Generator(device=cost.device).manual_seed(seed)
    history: list[Tensor] = []
    while len(history) < max_iterations:
        length = min(BLOCK, max_iterations - len(history))
        point, objectives = _block(length, point, levels, matrices, batch.mask)
        history += objectives
        if length < BLOCK or bool(levels.finished.all()):
            break
        point = _disturbed(point, levels.take_stuck(), matrices, batch, generator)
    objective = torch.stack(history) * scale
    return Descent(point.assignment, levels.iterations, levels.penalty, objective)


def _block(
    length: int, point: Evaluated, levels: _Levels, matrices: Tensor, mask: Tensor
) -> tuple[Evaluated, list[Tensor]]:
    """Some iterations of all problems, and the objective after each; the host waits for nothing."""
    objectives = []
    for _ in range(length):
        gradient = point.gradient(levels.penalty)
        target = point.assignment - levels.step[:, None, None] * gradient
        new = evaluate(project_rows(target, mask, levels.at_most), matrices)
        move = new.assignment - point.assignment
        before, after = point.objective(levels.penalty), new.objective(levels.penalty)
        decrease = ARMIJO * (gradient * move).sum((1, 2))
        accept = (after <= before + decrease) & ~levels.finished
        point = _choose(accept, new, point)
        objectives.append(torch.where(accept, after, before))
        levels.advance(accept, move.abs().amax((1, 2)) < TOLERANCE, point)
    return point, objectives


class _Levels:
    """Where each problem of a batch stands in the schedule of d: all (B,)."""

    def __init__(self, penalty: Tensor, stiffness: Tensor, size: Tensor, loose: Tensor) -> None:
        self.penalty, self.stiffness, self.size = penalty, stiffness, size
        self.loose = self.at_most = loose  # where row sums may be less than 1: if d is low; now
        self.step = self._first_step()
        self.tried = torch.zeros_like(size)  # steps at this level
        self.iterations = torch.zeros_like(size)
        self.finished = torch.zeros_like(size, dtype=torch.bool)
        self.stuck = torch.zeros_like(size, dtype=torch.bool)

    def advance(self, accept: Tensor, still: Tensor, point: Evaluated) -> None:
        """Take a trial step into account: finish, or double d, or change the step size."""
        self.iterations = self.iterations + ~self.finished
        self.tried = self.tried + 1
        clean = (point.violation <= TOLERANCE * self.size) & (
            point.row_sum + self.size <= TOLERANCE
        )
        self.finished = self.finished | (still & clean)
        settled = (still | (self.tried >= LEVEL_ITERATIONS)) & ~self.finished
        self.stuck = self.stuck | settled
        self.penalty = torch.where(settled, 2 * self.penalty, self.penalty)
        step = self.step * torch.where(accept, GROW, SHRINK)
        self.step = torch.where(settled, self._first_step(), step)
        self.tried = torch.where(settled, 0, self.tried)
        self.at_most = self.loose & (self.penalty < self.size + 1)

    def take_stuck(self) -> Tensor:
        """Which problems ended a level where a constraint is broken, since last asked."""
        stuck = self.stuck & ~self.finished
        self.stuck = torch.zeros_like(self.stuck)
        return stuck

    def _first_step(self) -> Tensor:
        return 1 / (self.stiffness + 2 * self.penalty)


def first_penalty(
    assignment: Float[Tensor, "B m k"],
    cost: Float[Tensor, "B m m"],
    distinctness: Float[Tensor, "B m m"],
) -> Float[Tensor, " B"]:
    """|median of −Ā / (U P_o + P_d U)| over the entries that are finite and not 0, else 1.

    It balances the gradients of cost and penalties at U, up to the sign (a heuristic of the
    authors' later version). Columns of Ā beyond the k of U are left out.
    """
    k = assignment.shape[-1]
    scale = assignment.sum(-1, keepdim=True) - assignment + distinctness @ assignment
    ratio = (cost[..., :k] / scale).abs()
    ratio = torch.where((ratio > 0) & ratio.isfinite(), ratio, torch.inf)
    ordered = ratio.flatten(1).sort(1).values  # torch's medians may differ from run to run on CUDA
    middle = (ordered.isfinite().sum(1, keepdim=True) - 1).clamp(min=0) // 2
    return ordered.gather(1, middle)[:, 0].nan_to_num(posinf=1.0)


def _choose(accept: Tensor, new: Evaluated, old: Evaluated) -> Evaluated:
    """The new point for those problems that accept it."""

    def pick(a: Tensor, b: Tensor) -> Tensor:
        return torch.where(accept.view(-1, *[1] * (a.ndim - 1)), a, b)

    return Evaluated(*(pick(getattr(new, f.name), getattr(old, f.name)) for f in fields(Evaluated)))


def _disturbed(
    point: Evaluated,
    chosen: Tensor,
    matrices: Tensor,
    batch: Batch,
    generator: torch.Generator,
) -> Evaluated:
    """The point with some noise, the more the farther a row is from a vertex, where chosen."""
    like = point.assignment
    noise = torch.rand(like.shape[1:], generator=generator, dtype=like.dtype, device=like.device)
    size = (1 - like.amax(2, keepdim=True)).clamp(min=DISTURBANCE)
    target = project_rows(like + size * noise, batch.mask)
    return _choose(chosen, evaluate(target, matrices), point)
