"""The relaxed problem of the paper (its eq. 4) as pure functions of a batch of matrices U.

Binary U with one 1 in each row says who is who: U[a, j] = 1 puts observation a into cluster j. The
relaxation lets U be real and charges for what a solution must not do:

    F_d(U) = <U Uᵀ, Ā> + d ( <Uᵀ U, P_o> + <U Uᵀ, P_d> + <Uᵀ U − Uᵀ − U, 1> )
    subject to  U >= 0 and row sums <= 1

    Ā     cost of putting two observations together, 0 on the diagonal and within views
    P_o   1 − I: 1 off the diagonal, so that columns become orthogonal
    P_d   1 between different observations that must not share a cluster (those of one view)
    1     the matrix of ones, so that row sums become 1

Every function takes leading batch dimensions. k, the number of columns, is m in the paper; fewer
will do where no more clusters are expected. Products with P_o and with the matrix of ones are
written by row sums r = U 1, and neither matrix is built. P_d is a matrix like Ā: both products are
then one matrix multiplication, which gives the same bits in every run, as an addition by index
does not on a GPU.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


def distinctness_matrix(
    view: Int[Tensor, "*batch m"], dtype: torch.dtype = torch.float32
) -> Float[Tensor, "*batch m m"]:
    """P_d: 1 between different observations of one view, 0 elsewhere and on the diagonal."""
    same = (view[..., :, None] == view[..., None, :]).to(dtype)
    return same - torch.eye(view.shape[-1], dtype=dtype, device=view.device)


def pair_cost(
    assignment: Float[Tensor, "*batch m k"], cost: Float[Tensor, "*batch m m"]
) -> Float[Tensor, "*batch"]:
    """<U Uᵀ, Ā>: for binary U, twice the sum of the cost over the pairs inside clusters."""
    return (assignment * (cost @ assignment)).sum((-2, -1))


def orthogonality_penalty(assignment: Float[Tensor, "*batch m k"]) -> Float[Tensor, "*batch"]:
    """<Uᵀ U, P_o> = ‖U 1‖² − ‖U‖²: 0 for U >= 0 iff no row has two entries that are not 0."""
    return assignment.sum(-1).square().sum(-1) - assignment.square().sum((-2, -1))


def distinctness_penalty(
    assignment: Float[Tensor, "*batch m k"], distinctness: Float[Tensor, "*batch m m"]
) -> Float[Tensor, "*batch"]:
    """<U Uᵀ, P_d>: 0 for U >= 0 iff observations that must differ have no column in common."""
    return pair_cost(assignment, distinctness)


def row_sum_penalty(assignment: Float[Tensor, "*batch m k"]) -> Float[Tensor, "*batch"]:
    """<Uᵀ U − Uᵀ − U, 1> = ‖U 1 − 1‖² − m: least, which is −m, iff all row sums are 1."""
    total = assignment.sum(-1)
    return (total.square() - 2 * total).sum(-1)


def relaxed_objective(
    assignment: Float[Tensor, "*batch m k"],
    cost: Float[Tensor, "*batch m m"],
    distinctness: Float[Tensor, "*batch m m"],
    penalty: float | Float[Tensor, "*batch"],
) -> Float[Tensor, "*batch"]:
    """F_d(U), the objective of eq. (4), with d = ``penalty``."""
    return pair_cost(assignment, cost) + penalty * (
        orthogonality_penalty(assignment)
        + distinctness_penalty(assignment, distinctness)
        + row_sum_penalty(assignment)
    )


def relaxed_gradient(
    assignment: Float[Tensor, "*batch m k"],
    cost: Float[Tensor, "*batch m m"],
    distinctness: Float[Tensor, "*batch m m"],
    penalty: float | Float[Tensor, "*batch"],
) -> Float[Tensor, "*batch m k"]:
    """∇F_d(U) = 2 Ā U + d ( 2 (r 1ᵀ − U) + 2 P_d U + 2 (r − 1) 1ᵀ ) with r = U 1."""
    total = assignment.sum(-1, keepdim=True)
    violation = 2 * total - 1 - assignment + distinctness @ assignment
    weight = torch.as_tensor(penalty, dtype=assignment.dtype, device=assignment.device)
    return 2 * (cost @ assignment) + 2 * weight[..., None, None] * violation


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


def project_to_simplex(rows: Float[Tensor, "*batch k"]) -> Float[Tensor, "*batch k"]:
    """The nearest point of the probability simplex, row by row.

        minimise ‖u − v‖²  over u,  subject to  u >= 0 and Σ u = 1

    The answer is u = max(v − τ, 0), where the threshold τ makes the sum 1. Sorting finds it:
    τ is the largest of (v₁ + … + v_i − 1) / i over the sorted v₁ >= v₂ >= ….
    """
    # Shifting a row moves τ by as much; with 0 as the largest entry no sum loses precision.
    centred = rows - rows.amax(-1, keepdim=True)
    ordered = centred.sort(-1, descending=True).values
    count = torch.arange(1, rows.shape[-1] + 1, dtype=rows.dtype, device=rows.device)
    threshold = ((ordered.cumsum(-1) - 1) / count).amax(-1, keepdim=True)
    return (centred - threshold).clamp(min=0)


def project_to_row_sum_at_most_one(rows: Float[Tensor, "*batch k"]) -> Float[Tensor, "*batch k"]:
    """The nearest point of the corner simplex, row by row: the constraint of eq. (4).

        minimise ‖u − v‖²  over u,  subject to  u >= 0 and Σ u <= 1

    Where max(v, 0) obeys the sum it is the answer; elsewhere the sum is 1 at the answer.
    """
    positive = rows.clamp(min=0)
    within = positive.sum(-1, keepdim=True) <= 1
    return torch.where(within, positive, project_to_simplex(rows))


def is_binary(
    assignment: Float[Tensor, "*batch m k"], tolerance: float = 1e-2
) -> Bool[Tensor, "*batch"]:
    """Whether every row is, within the tolerance, one 1 and zeros."""
    distance = (assignment - assignment.round()).abs().amax((-2, -1))
    one = (assignment.round().sum(-1) == 1).all(-1)
    return one & (distance <= tolerance)
