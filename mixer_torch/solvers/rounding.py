"""From the relaxation's matrix to labels that keep every constraint."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy.optimize import linear_sum_assignment
from torch import Tensor


def nearest_labels(
    assignment: Float[Tensor, "m k"], view: Int64[Tensor, " m"]
) -> Int64[Tensor, " m"]:
    """The nearest feasible assignment, view by view.

        minimise ‖V_i − U_i‖²  over binary V_i with one 1 in each row, at most one in each column

    for the rows U_i of each view i. Since ‖v − u‖² = 1 + ‖u‖² − 2 u_j for v = e_j, this is the
    linear assignment that gains the most of U; a fresh column, gaining 0, is always there.
    """
    weight = assignment.detach().cpu().double().numpy()
    views = view.cpu().numpy()
    m, k = weight.shape
    labels = np.where(weight.max(1, initial=0) > 0, weight.argmax(1), k + np.arange(m))
    for value in np.flatnonzero(np.bincount(views) > 1):
        rows = np.flatnonzero(views == value)
        fresh = np.eye(len(rows)) - 1  # each row has a column of its own, and gains 0 by it
        _, column = linear_sum_assignment(np.hstack([weight[rows], fresh]), maximize=True)
        labels[rows] = np.where(column < k, column, k + rows)
    return torch.from_numpy(labels.astype(np.int64)).to(view.device)
