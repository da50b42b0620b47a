"""Projected gradient descent on a padded batch of relaxed problems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from mixer_torch.solvers.relaxation import (
    distinctness_penalty,
    orthogonality_penalty,
    pair_cost,
    project_to_row_sum_at_most_one,
    project_to_simplex,
)

PROJECTIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "row_sum_at_most_one": project_to_row_sum_at_most_one,
    "simplex": project_to_simplex,
}

ARMIJO = 1e-4
SHRINK = 0.25
GROW = 2.0


@dataclass(frozen=True)
class Descent:
    """Where a descent ended, for each problem of the batch.

    Args:
        assignment: (B, m, k) U.
        iterations: (B,) steps tried until the problem was finished.
        penalty: (B,) the last d.
        violation: (B,) the sum of both penalties at U.
        history: (T, B) relaxed objective at each iteration.
    """

    assignment: Float[Tensor, "B m k"]
    iterations: Int64[Tensor, " B"]
    penalty: Float[Tensor, " B"]
    violation: Float[Tensor, " B"]
    history: Float[Tensor, "T B"]


@dataclass(frozen=True)
class _Point:
    """U with the products and sums that its objective and gradient are made of."""

    assignment: Tensor
    cost_product: Tensor
    distinctness_product: Tensor
    pair_cost: Tensor
    violation: Tensor
    row_sum: Tensor

    def objective(self, penalty: Tensor) -> Tensor:
        return self.pair_cost + penalty * (self.violation + self.row_sum)

    def gradient(self, penalty: Tensor) -> Tensor:
        total = self.assignment.sum(-1, keepdim=True)
        violation = 2 * total - 1 - self.assignment + self.distinctness_product
        return 2 * (self.cost_product + penalty[:, None, None] * violation)


def _measure(assignment: Tensor, both: Tensor, mask: Tensor) -> _Point:
    """The point U; ``both`` is Ā over P_d, (B, 2m, m), so that one product serves both."""
    m = assignment.shape[1]
    products = both @ assignment
    total = assignment.sum(-1)
    square = total.square().sum(-1)
    cost_product, distinctness_product = products[:, :m], products[:, m:]
    shared = (assignment * distinctness_product).sum((-2, -1))
    return _Point(
        assignment,
        cost_product,
        distinctness_product,
        (assignment * cost_product).sum((-2, -1)),
        square - assignment.square().sum((-2, -1)) + shared,
        square - 2 * total.sum(-1),
    )


def _choose(accept: Tensor, new: _Point, old: _Point) -> _Point:
    def pick(name: str) -> Tensor:
        a, b = getattr(new, name), getattr(old, name)
        return torch.where(accept.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    return _Point(**{name: pick(name) for name in _Point.__dataclass_fields__})


def first_penalty(
    assignment: Float[Tensor, "B m k"],
    cost: Float[Tensor, "B m m"],
    distinctness: Float[Tensor, "B m m"],
) -> Float[Tensor, " B"]:
    """|median of −Ā / (U P_o + P_d U)| over the entries that are finite and not 0, else 1.

    It balances the gradients of cost and penalties at U, up to the sign (a heuristic of the
    authors' later version). It needs k = m; further columns of Ā are left out.
    """
    k = assignment.shape[-1]
    scale = assignment.sum(-1, keepdim=True) - assignment + distinctness @ assignment
    ratio = (cost[..., :k] / scale).abs()
    ratio = torch.where((ratio > 0) & ratio.isfinite(), ratio, torch.nan)
    return ratio.flatten(1).nanmedian(1).values.nan_to_num(1.0)


def descend(
    cost: Float[Tensor, "B m m"],
    distinctness: Float[Tensor, "B m m"],
    mask: Bool[Tensor, "B m"],
    start: Float[Tensor, "B m k"],
    *,
    projection: str = "row_sum_at_most_one",
    max_iterations: int = 1000,
    level_iterations: int = 50,
    tolerance: float = 1e-4,
    check_every: int = 10,
) -> Descent:
    """Projected gradient descent with Armijo backtracking, d doubled until both penalties vanish.

    For each d, F_d is minimised from where the last one ended, until a step moves no entry by more
    than the tolerance. Each problem has its own step size and its own d; those that are finished
    stay as they are. The host looks every ``check_every`` iterations whether all are finished.

    Args:
        cost: Ā, scaled so that its largest entry is about 1.
        distinctness: P_d.
        mask: Which rows are observations; the others are padding.
        start: U to begin with, feasible for the projection.
        projection: "row_sum_at_most_one", as in the paper, or "simplex".
        max_iterations: Trial steps in all.
        level_iterations: Trial steps at most before d is doubled.
        tolerance: Movement of an entry, and violation an observation, that count as none.
        check_every: Iterations between two looks by the host.
    """
    project = PROJECTIONS[projection]
    both = torch.cat([cost, distinctness], 1)
    limit = mask.sum(1) + 1.0
    keep = mask[..., None].to(start.dtype)
    point = _measure(start * keep, both, mask)
    penalty = first_penalty(point.assignment, cost, distinctness).clamp(1e-3, 1.0)
    first_step = 0.5 / (cost.abs().sum(2).amax(1) + 1)
    step = first_step.clone()
    level = torch.zeros_like(step)
    finished = torch.zeros_like(step, dtype=torch.bool)
    iterations = torch.zeros_like(step, dtype=torch.int64)
    history = []
    for iteration in range(max_iterations):
        gradient = point.gradient(penalty)
        trial = project(point.assignment - step[:, None, None] * gradient) * keep
        move = trial - point.assignment
        new = _measure(trial, both, mask)
        before, after = point.objective(penalty), new.objective(penalty)
        accept = after <= before + ARMIJO * (gradient * move).sum((-2, -1))
        accept &= ~finished
        distance = move.abs().amax((-2, -1))
        point = _choose(accept, new, point)
        history.append(torch.where(accept, after, before))
        iterations += ~finished
        level += 1
        settled = (distance < tolerance) | (level >= level_iterations)
        clean = point.violation <= tolerance * mask.sum(1)
        finished |= settled & ((clean & (distance < tolerance)) | (penalty >= limit))
        penalty = torch.where(settled & ~finished, 2 * penalty, penalty)
        level = torch.where(settled, 0, level)
        step = torch.where(accept, GROW * step, SHRINK * step)
        step = torch.where(settled, first_step, step)
        if iteration % check_every == check_every - 1 and bool(finished.all()):
            break
    return Descent(point.assignment, iterations, penalty, point.violation, torch.stack(history))
