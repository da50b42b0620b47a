"""From the relaxation's matrix to labels that keep every constraint."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from mixer_torch.solvers.gradient.batch import Batch
from mixer_torch.solvers.gradient.relaxation import is_binary


def binary_labels(
    assignment: Float[Tensor, "B m k"], batch: Batch
) -> tuple[Int64[Tensor, "B m"], Bool[Tensor, " B"]]:
    """The largest column of each row, and for which problems that is U itself, and feasible."""
    labels = assignment.argmax(2)
    together = labels[:, :, None] == labels[:, None, :]
    conflict = (together * batch.distinctness).amax((1, 2)) > 0
    padding = torch.nn.functional.one_hot(labels, assignment.shape[2]).to(assignment)
    whole = torch.where(batch.mask[..., None], assignment, padding)
    return labels, is_binary(whole) & ~conflict


def nearest_labels(
    assignment: Float[Tensor, "m k"], apart: Bool[Tensor, "m m"]
) -> Int64[Tensor, " m"]:
    """The nearest feasible assignment, view by view.

        minimise ‖V_i − U_i‖²  over binary V_i with one 1 in each row, at most one in each column

    for the rows U_i of each view i. Since ‖v − u‖² = 1 + ‖u‖² − 2 u_j for v = e_j, this is the
    linear assignment that gains the most of U; a fresh column, gaining 0, is always there. Rows
    with sets of views are assigned one by one, the largest entry first, where nothing forbids it.

    Args:
        assignment: U.
        apart: Which rows may not share a column: cliques where each row is of one view.
    """
    weight = assignment.detach().cpu().double().numpy()
    conflict = apart.cpu().numpy() | np.eye(len(weight), dtype=bool)
    if (conflict == conflict[conflict.argmax(1)]).all():
        labels = _by_view(weight, conflict.argmax(1))
    else:
        labels = _one_by_one(weight, conflict)
    return torch.from_numpy(labels).to(assignment.device)


def _by_view(weight: np.ndarray, view: np.ndarray) -> np.ndarray:
    m, k = weight.shape
    labels = np.empty(m, np.int64)
    for value in np.unique(view):
        rows = np.flatnonzero(view == value)
        fresh = np.eye(len(rows)) - 1  # each row has a column of its own, and gains 0 by it
        _, column = linear_sum_assignment(np.hstack([weight[rows], fresh]), maximize=True)
        labels[rows] = np.where(column < k, column, k + rows)
    return labels


def _one_by_one(weight: np.ndarray, conflict: np.ndarray) -> np.ndarray:
    m, k = weight.shape
    labels = np.full(m, -1, np.int64)
    for row in np.argsort(-weight.max(1), kind="stable"):
        taken = labels[conflict[row] & (labels >= 0)]
        gain = weight[row].copy()
        gain[taken[taken < k]] = 0
        labels[row] = gain.argmax() if gain.max() > 0 else k + row
    return labels
