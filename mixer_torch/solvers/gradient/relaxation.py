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

from dataclasses import dataclass

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
    assignment: Float[Tensor, "*batch m k"], cost_product: Float[Tensor, "*batch m k"]
) -> Float[Tensor, "*batch"]:
    """<U Uᵀ, Ā> from U and Ā U: for binary U, twice the cost of the pairs inside clusters."""
    return (assignment * cost_product).sum((-2, -1))


def orthogonality_penalty(assignment: Float[Tensor, "*batch m k"]) -> Float[Tensor, "*batch"]:
    """<Uᵀ U, P_o> = ‖U 1‖² − ‖U‖²: 0 for U >= 0 iff no row has two entries that are not 0."""
    return assignment.sum(-1).square().sum(-1) - assignment.square().sum((-2, -1))


def distinctness_penalty(
    assignment: Float[Tensor, "*batch m k"], distinctness_product: Float[Tensor, "*batch m k"]
) -> Float[Tensor, "*batch"]:
    """<U Uᵀ, P_d> from U and P_d U: 0 for U >= 0 iff what must differ shares no column."""
    return (assignment * distinctness_product).sum((-2, -1))


def row_sum_penalty(assignment: Float[Tensor, "*batch m k"]) -> Float[Tensor, "*batch"]:
    """<Uᵀ U − Uᵀ − U, 1> = ‖U 1 − 1‖² − m: least, which is −m, iff all row sums are 1."""
    total = assignment.sum(-1)
    return total.square().sum(-1) - 2 * total.sum(-1)


@dataclass(frozen=True)
class Evaluated:
    """U, and what F_d and its gradient need to know of it, whatever d is.

    Args:
        assignment: U.
        cost_product: Ā U.
        distinctness_product: P_d U.
        pair_cost: <U Uᵀ, Ā>.
        violation: <Uᵀ U, P_o> + <U Uᵀ, P_d>, 0 iff columns are orthogonal and views distinct.
        row_sum: <Uᵀ U − Uᵀ − U, 1>, −m iff row sums are 1.
    """

    assignment: Float[Tensor, "*batch m k"]
    cost_product: Float[Tensor, "*batch m k"]
    distinctness_product: Float[Tensor, "*batch m k"]
    pair_cost: Float[Tensor, "*batch"]
    violation: Float[Tensor, "*batch"]
    row_sum: Float[Tensor, "*batch"]

    def objective(self, penalty: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """F_d(U), the objective of eq. (4), with d = ``penalty``."""
        return self.pair_cost + penalty * (self.violation + self.row_sum)

    def gradient(self, penalty: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch m k"]:
        """∇F_d(U) = 2 Ā U + d ( 2 (r 1ᵀ − U) + 2 P_d U + 2 (r − 1) 1ᵀ ) with r = U 1."""
        total = self.assignment.sum(-1, keepdim=True)
        violation = 2 * total - 1 - self.assignment + self.distinctness_product
        return 2 * (self.cost_product + penalty[..., None, None] * violation)


def evaluate(
    assignment: Float[Tensor, "*batch m k"], matrices: Float[Tensor, "*batch 2*m m"]
) -> Evaluated:
    """What F_d needs to know of U; ``matrices`` is Ā over P_d, so that one product serves both."""
    cost_product, distinctness_product = (matrices @ assignment).chunk(2, -2)
    orthogonality = orthogonality_penalty(assignment)
    return Evaluated(
        assignment,
        cost_product,
        distinctness_product,
        pair_cost(assignment, cost_product),
        orthogonality + distinctness_penalty(assignment, distinctness_product),
        row_sum_penalty(assignment),
    )


def graduated_objective(
    form: Float[Tensor, "T B"],
    square: Float[Tensor, "T B"],
    observations: Int[Tensor, " B"],
    curvature: Float[Tensor, "T 1"],
) -> Float[Tensor, "T B"]:
    """<U Uᵀ, Ā + w P_d> + c (m − ‖U‖²): F_d on the simplex, each penalty with its own weight.

    With row sums 1 the orthogonality penalty is m − ‖U‖², and the penalty of row sums is constant.

    Args:
        form: <U Uᵀ, Ā + w P_d> at each step, for each problem.
        square: ‖U‖², likewise.
        observations: m of each problem.
        curvature: c at each step, the weight of the orthogonality penalty.
    """
    return form + curvature * (observations - square)


def graduated_step(
    step_size: Float[Tensor, "T B"], curvature: Float[Tensor, "T 1"]
) -> tuple[Float[Tensor, "T B"], Float[Tensor, "T B"]]:
    """(h, b) of a step down the graduated objective, which leads to h U + b (Ā + w P_d) U.

    Half of the gradient is (Ā + w P_d) U − c U, so h = 1 + c ``step_size``, b = −``step_size``.
    """
    return 1 + curvature * step_size, -step_size


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
