"""Projections of the rows of a padded batch, fast enough for the inner loop."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mixer_torch.solvers.compiled import compiled, vectorised
from mixer_torch.solvers.gradient.relaxation import (
    project_to_row_sum_at_most_one,
    project_to_simplex,
)


def project_rows(
    rows: Float[Tensor, "B m k"],
    keep: Bool[Tensor, "B m"],
    at_most: Bool[Tensor, " B"] | None = None,
) -> Float[Tensor, "B m k"]:
    """Rows that are kept onto the simplex, or where it is said onto row sums <= 1; others to 0.

    Elsewhere than on the CPU this calls the projections of
    :mod:`mixer_torch.solvers.gradient.relaxation`. On the CPU a compiled loop computes the same in
    less time, and may overwrite ``rows``.
    """
    if at_most is None:
        at_most = torch.zeros_like(keep[:, 0])
    if rows.device.type == "cpu":
        rows = rows.contiguous()
        _project(rows.numpy(), keep.numpy(), at_most.numpy())
        return rows
    equal = project_to_simplex(rows)
    loose = project_to_row_sum_at_most_one(rows)
    return torch.where(at_most[:, None, None], loose, equal) * keep[..., None]


@compiled
def _project(batch: np.ndarray, keep: np.ndarray, at_most: np.ndarray) -> None:
    for b in range(len(batch)):
        for i in range(batch.shape[1]):
            if keep[b, i]:
                project_row(batch[b, i], at_most[b])
            else:
                batch[b, i] = 0


@vectorised
def project_row(row: np.ndarray, at_most: bool) -> None:
    """Project one row in place, without sorting: max(row − τ, 0), the sum being 1.

    First τ = max row − 1, which no τ is below; then the τ for which the entries above it have that
    sum; then the same for the entries above that one, and so on. τ rises until no further entry
    drops out (Michelot, 1986): a few passes of several entries at a time. With 0 as the largest
    entry no sum loses precision. A row whose positive entries add up to less than 1 has a threshold
    below 0, which ``at_most`` ends at.
    """
    zero, one, largest = row.dtype.type(0), row.dtype.type(1), _largest(row)
    for j in range(len(row)):
        row[j] -= largest
    threshold, before = -one, one * (len(row) + 1)
    while True:
        total, count = zero, zero
        for j in range(len(row)):
            total += row[j] if row[j] > threshold else zero
            count += one if row[j] > threshold else zero
        if count >= before:
            break
        before = count
        threshold = (total - one) / count
    if at_most:
        threshold = max(threshold, -largest)
    for j in range(len(row)):
        row[j] = max(row[j] - threshold, zero)


@vectorised
def _largest(row: np.ndarray) -> np.floating:
    """Four at a time: the compiler takes one after the other, and each has to wait for the last."""
    a = b = c = d = row[0]
    whole = len(row) - len(row) % 4
    for j in range(0, whole, 4):
        a, b = max(a, row[j]), max(b, row[j + 1])
        c, d = max(c, row[j + 2]), max(d, row[j + 3])
    for j in range(whole, len(row)):
        a = max(a, row[j])
    return max(max(a, b), max(c, d))
