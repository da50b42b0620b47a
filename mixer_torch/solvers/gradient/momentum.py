"""Steps of projected gradient descent with momentum on a padded batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mixer_torch.solvers.compiled import compiled, vectorised
from mixer_torch.solvers.gradient.projection import project_row, project_rows

MOMENTUM = 0.5  # with steps of 2 / L; set by hand together with them


def travel(
    assignment: Float[Tensor, "B m k"],
    hold: Float[Tensor, "T B"],
    back: Float[Tensor, "T B"],
    keep: Bool[Tensor, "B m"],
    product: Callable[[int, Tensor], Tensor],
) -> tuple[Float[Tensor, "B m k"], Float[Tensor, "T 2 B"]]:
    """Step after step from U, with Y = U at first.

        U⁺ = P(hold Y + back A Y),     Y⁺ = U⁺ + MOMENTUM (U⁺ − U)

    with P onto the simplex, row by row, and 0 in rows that are not kept. On the CPU a step is
    compiled, in one pass over the memory.

    Args:
        assignment: U, which may be written.
        hold: Of each step and problem.
        back: Likewise.
        keep: Rows that are no padding.
        product: A Y at a step, for the matrix A of the objective's quadratic form.

    Returns:
        The last U, and <Y, A Y> and <Y, Y> at each step.
    """
    ahead, forms = assignment.clone(), []
    if ahead.device.type != "cpu":
        for t, (own, other) in enumerate(zip(hold.unbind(), back.unbind(), strict=True)):
            moved = product(t, ahead)
            assignment, ahead, form = advance(assignment, ahead, moved, own, other, keep)
            forms.append(form)
        return assignment, torch.stack(forms)
    told = ahead.new_empty(len(hold), 2, len(ahead))
    # looked at once: for small batches that takes as long as the work, and threads wait for it
    arrays = [x.numpy() for x in (assignment, ahead, keep, hold, back, told)]
    for t in range(len(hold)):
        _advance(t, *arrays, product(t, ahead).numpy())
    return assignment, told


def advance(
    assignment: Float[Tensor, "B m k"],
    ahead: Float[Tensor, "B m k"],
    product: Float[Tensor, "B m k"],
    hold: Float[Tensor, " B"],
    back: Float[Tensor, " B"],
    keep: Bool[Tensor, "B m"],
) -> tuple[Tensor, Tensor, Tensor]:
    """A step of :func:`travel` in torch alone, on any device: U⁺, Y⁺ and the two forms (2, B)."""
    flat = ahead.flatten(1)
    forms = torch.stack(
        [torch.linalg.vecdot(flat, product.flatten(1)), torch.linalg.vecdot(flat, flat)]
    )
    target = (ahead * hold[:, None, None]).addcmul_(product, back[:, None, None])
    moved = project_rows(target, keep)
    return moved, torch.lerp(assignment, moved, 1 + MOMENTUM), forms


@compiled
def _advance(t, assignment, ahead, keep, hold, back, forms, product):  # type: ignore[no-untyped-def]
    push = assignment.dtype.type(MOMENTUM)
    row = np.empty(assignment.shape[2], assignment.dtype)
    for b in range(len(assignment)):
        value, square = 0.0, 0.0
        for i in range(assignment.shape[1]):
            if not keep[b, i]:
                assignment[b, i] = 0
                ahead[b, i] = 0
                continue
            own, norm = _target(ahead, product, b, i, hold[t, b], back[t, b], row)
            value += own
            square += norm
            project_row(row, False)
            _follow(assignment, ahead, b, i, row, push)
        forms[t, 0, b], forms[t, 1, b] = value, square


@vectorised
def _target(ahead, product, b, i, hold, back, row):  # type: ignore[no-untyped-def]
    """Write where row i goes before it is projected; what it adds to the two forms."""
    value = square = row.dtype.type(0)
    for j in range(len(row)):
        y = ahead[b, i, j]
        value += y * product[b, i, j]
        square += y * y
        row[j] = hold * y + back * product[b, i, j]
    return value, square


@vectorised
def _follow(assignment, ahead, b, i, row, push):  # type: ignore[no-untyped-def]
    """Row i of U becomes the projection, and Y goes beyond it."""
    for j in range(len(row)):
        ahead[b, i, j] = row[j] + push * (row[j] - assignment[b, i, j])
        assignment[b, i, j] = row[j]
