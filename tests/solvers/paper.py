"""Formulas of the paper by their definitions, for what the library computes in other ways."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from mixer_torch.solvers.gradient.relaxation import Evaluated, evaluate


def evaluated(
    assignment: Float[Tensor, "*batch m k"],
    cost: Float[Tensor, "*batch m m"],
    distinctness: Float[Tensor, "*batch m m"],
) -> Evaluated:
    """U with what F_d and its gradient need to know of it."""
    return evaluate(assignment, torch.cat([cost, distinctness], -2))


def frobenius_objective(
    assignment: Float[Tensor, "*batch m k"], scores: Float[Tensor, "*batch l m m"]
) -> Float[Tensor, "*batch"]:
    """‖U Uᵀ ⊗ I_l − A‖²_F, the objective of eq. (1), by the definition.

    The Kronecker matrix A is diagonal in each block, so the norm is a sum over modalities and
    pairs, Σ_k ‖U Uᵀ − S_k‖²_F; what is off those diagonals is 0 on both sides.

    Args:
        assignment: U.
        scores: S_k for each modality k.
    """
    together = assignment @ assignment.mT
    return (together[..., None, :, :] - scores).square().sum((-3, -2, -1))
