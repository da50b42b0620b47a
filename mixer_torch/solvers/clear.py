"""CLEAR: spectral clustering with a normalised Laplacian, and assignment to pivots in each view."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from mixer_torch.association import Status
from mixer_torch.solvers.eigen import eigh
from mixer_torch.solvers.problem import Problem, Solution
from mixer_torch.solvers.synchronization import (
    Synchronization,
    bounded_universe,
    evidence_matrix,
    normalized_laplacian,
)


class Clear(Synchronization):
    """Consistent lifting, embedding and alignment rectification.

    1. The universe: as many objects as the Laplacian (D + I)^-1/2 (D − W) (D + I)^-1/2 has
       eigenvalues below 0.5, and at least as many as the largest view has observations.
    2. Embedding: the eigenvectors of the k smallest eigenvalues, rows scaled to length 1.
    3. Pivots: the first row, then k − 1 times the row whose inner products with the pivots so far
       have the least sum of magnitudes.
    4. Alignment: in each view, the linear assignment of its rows to the pivots with the least sum
       of 1 − <row, pivot>. Every observation is assigned, however far its pivot is.

    Needs one score a pair; soft scores: see ``evidence``. Labels are always feasible.

    Source: Fathian, Khosoussi, Tian, Lusk and How, CLEAR: A consistent lifting, embedding, and
    alignment rectification algorithm for multiview data association, IEEE Transactions on Robotics
    36, 2020.

    Args:
        universe: The number of objects, None to estimate it from the spectrum.
        evidence: What scores become; :mod:`mixer_torch.solvers.synchronization` has the kinds.
        threshold: Eigenvalues below it are counted as objects.
    """

    def run(self, problem: Problem) -> Solution:
        weight = evidence_matrix(problem, self.evidence)
        values, vectors = eigh(normalized_laplacian(weight))
        size = self.universe or int((values < self.threshold).sum())
        size = bounded_universe(size, problem.view)
        rows = torch.nn.functional.normalize(vectors[:, :size], dim=1)
        labels = assign(1 - rows @ rows[pivots(rows)].T, problem.view)
        return Solution(Status.CONVERGED, labels=labels, stats={"universe": size})


def pivots(rows: Float[Tensor, "m k"]) -> Int64[Tensor, " k"]:
    """Step 3: the indices of the k pivots."""
    product = (rows @ rows.T).abs()
    chosen = torch.zeros(rows.shape[1], dtype=torch.int64, device=rows.device)
    overlap = product[0].clone()
    overlap[0] = torch.inf
    for i in range(1, len(chosen)):
        chosen[i] = overlap.argmin()
        overlap += product[chosen[i]]
        overlap[chosen[i]] = torch.inf
    return chosen


def assign(distance: Float[Tensor, "m k"], view: Int64[Tensor, " m"]) -> Int64[Tensor, " m"]:
    """Step 4: the column of each row, all different within a view, of the least total distance."""
    table, views = distance.cpu().double().numpy(), view.cpu().numpy()
    labels = np.zeros(len(views), dtype=np.int64)
    for value in np.unique(views):
        rows = np.flatnonzero(views == value)
        labels[rows] = linear_sum_assignment(table[rows])[1]
    return torch.from_numpy(labels).to(view.device)
