"""Permutation synchronisation by eigenvectors, for partial matches."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from mixer_torch.association import Status
from mixer_torch.solvers.eigen import eigh
from mixer_torch.solvers.problem import Problem, Solution
from mixer_torch.solvers.synchronization import Synchronization, greedy_rounding


class Spectral(Synchronization):
    """The eigenvectors of the matches, rounded to objects.

    With W + I the matrix of pairwise matches and k the number of objects,

        maximise  <V Vᵀ, W + I>  over V (m, k) with orthonormal columns,

    solved by the k leading eigenvectors. The original rounds V V_1ᵀ, for the rows V_1 of the first
    view, by linear assignment in each view, which asks that every view has all objects. The
    extension to partial views of different sizes normalises the rows of V and groups them
    greedily: an object takes from each view the row with the largest inner product, above 0.5.

    Needs k: estimated by :func:`~mixer_torch.solvers.synchronization.universe_size` unless given.
    Soft scores: see ``evidence``. Labels are always feasible.

    Sources: Pachauri, Kondor and Singh, Solving the multi-way matching problem by permutation
    synchronization, NeurIPS 2013; extension: Zhou, Zhu and Daniilidis, Multi-image matching via
    fast alternating minimization, ICCV 2015.

    Args:
        universe: The number of objects, None to estimate it.
        evidence: What scores become; :mod:`mixer_torch.solvers.synchronization` has the kinds.
        threshold: Least inner product of an observation and the one that started its object.
    """

    def run(self, problem: Problem) -> Solution:
        weight, size = self.inputs(problem)
        vectors = embedding(weight, size)
        labels = greedy_rounding(vectors @ vectors.T, problem.view, self.threshold)
        return Solution(Status.CONVERGED, labels=labels, stats={"universe": size})


def embedding(weight: Float[Tensor, "m m"], size: int) -> Float[Tensor, "m k"]:
    """Rows of the k leading eigenvectors of W + I, scaled to length 1."""
    vectors = eigh(weight)[1][:, -size:]  # W and W + I share their eigenvectors
    return torch.nn.functional.normalize(vectors, dim=1)
