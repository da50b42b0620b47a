"""Projections of the rows of a padded batch, fast enough for the inner loop."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.relaxation import project_to_row_sum_at_most_one, project_to_simplex


def project_rows(
    rows: Float[Tensor, "B m k"],
    keep: Bool[Tensor, "B m"],
    at_most: Bool[Tensor, " B"] | None = None,
) -> Float[Tensor, "B m k"]:
    """Rows that are kept onto the simplex, or where it is said onto row sums <= 1; others to 0.

    The same as the functions of :mod:`mixer_torch.solvers.relaxation`, for the inner loop: on the
    CPU it is compiled, and may overwrite ``rows``.
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
    """In place. A row whose positive entries add up to less than 1 has a threshold below 0."""
    above = np.empty(batch.shape[2], batch.dtype)
    for b in range(len(batch)):
        for i in range(batch.shape[1]):
            row = batch[b, i]
            if keep[b, i]:
                threshold = _threshold(row, above)
                if at_most[b]:
                    threshold = max(threshold, 0.0)
                for j in range(len(row)):
                    row[j] = max(row[j] - threshold, 0)
            else:
                row[:] = 0


@compiled
def _threshold(row: np.ndarray, above: np.ndarray) -> float:
    """τ for which max(row − τ, 0) has the sum 1, without sorting.

    First the τ for which row − τ has that sum, or a better bound from below; then the same for the
    entries above it, and so on. τ rises until no further entry drops out (Michelot, 1986): a few
    passes over a short list in the cache, several times faster than a sort of the whole batch.
    """
    total, largest = 0.0, row[0]
    for value in row:
        total += value
        largest = max(largest, value)
    threshold = max((total - 1) / len(row), largest - 1)
    count = 0
    for value in row:
        if value > threshold:
            above[count] = value
            count += 1
    before = count + 1
    while 0 < count < before:
        total = 0.0
        for j in range(count):
            total += above[j]
        threshold = (total - 1) / count
        before, count = count, 0
        for j in range(before):
            if above[j] > threshold:
                above[count] = above[j]
                count += 1
    return threshold
