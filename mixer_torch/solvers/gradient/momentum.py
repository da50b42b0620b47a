"""One step of projected gradient descent with momentum on a padded batch."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mixer_torch.solvers.compiled import compiled, vectorised
from mixer_torch.solvers.gradient.projection import project_row, project_rows

MOMENTUM = 0.5


def advance(
    assignment: Float[Tensor, "B m k"],
    ahead: Float[Tensor, "B m k"],
    product: Float[Tensor, "B m k"],
    hold: Float[Tensor, " B"],
    back: Float[Tensor, " B"],
    keep: Bool[Tensor, "B m"],
) -> tuple[Tensor, Tensor, Tensor]:
    """The next U, where its momentum leads, and what the point it came from says of the objective.

        U⁺ = P(hold Y + back A Y),     Y⁺ = U⁺ + MOMENTUM (U⁺ − U)

    with P onto the simplex, row by row, and 0 in rows that are not kept. On the CPU it is compiled,
    in one pass over the memory, and writes to ``assignment`` and ``ahead``.

    Args:
        assignment: U.
        ahead: Y.
        product: A Y, for the matrix A of the objective's quadratic form.
        hold: Of each problem.
        back: Of each problem.
        keep: Rows that are no padding.

    Returns:
        U⁺, Y⁺, and (2, B): <Y, A Y> and <Y, Y>.
    """
    if ahead.device.type == "cpu":
        forms = ahead.new_empty(2, len(ahead))
        arrays = (assignment, ahead, product, hold, back, keep, forms)
        _advance(*(array.numpy() for array in arrays))
        return assignment, ahead, forms
    return advance_anywhere(assignment, ahead, product, hold, back, keep)


def advance_anywhere(
    assignment: Float[Tensor, "B m k"],
    ahead: Float[Tensor, "B m k"],
    product: Float[Tensor, "B m k"],
    hold: Float[Tensor, " B"],
    back: Float[Tensor, " B"],
    keep: Bool[Tensor, "B m"],
) -> tuple[Tensor, Tensor, Tensor]:
    """:func:`advance` in torch alone, on any device; writes to none of its arguments."""
    flat = ahead.flatten(1)
    forms = torch.stack(
        [torch.linalg.vecdot(flat, product.flatten(1)), torch.linalg.vecdot(flat, flat)]
    )
    target = (ahead * hold[:, None, None]).addcmul_(product, back[:, None, None])
    moved = project_rows(target, keep)
    return moved, torch.lerp(assignment, moved, 1 + MOMENTUM), forms


@compiled
def _advance(assignment, ahead, product, hold, back, keep, forms):  # type: ignore[no-untyped-def]
    push = assignment.dtype.type(MOMENTUM)
    row = np.empty(assignment.shape[2], assignment.dtype)
    for b in range(len(assignment)):
        value, square = 0.0, 0.0
        for i in range(assignment.shape[1]):
            if not keep[b, i]:
                assignment[b, i] = 0
                ahead[b, i] = 0
                continue
            own, norm = _target(ahead, product, b, i, hold[b], back[b], row)
            value += own
            square += norm
            project_row(row, False)
            _follow(assignment, ahead, b, i, row, push)
        forms[0, b], forms[1, b] = value, square


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
