"""Eigendecomposition that succeeds where LAPACK's fails: for equal eigenvalues."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

SPLIT = 1e-9  # of the largest entry: far above the rounding of float64, below that of float32


def eigh(
    matrix: Float[Tensor, "*batch n n"],
) -> tuple[Float[Tensor, "*batch n"], Float[Tensor, "*batch n n"]]:
    """Eigenvalues, ascending, and eigenvectors of symmetric matrices, on their device.

    LAPACK's divide and conquer does not converge, or ends in NaN, for some matrices of few
    different entries, which have many equal eigenvalues; matches and semantic colours make such
    matrices. Those are decomposed again in float64, with a ramp of a billionth of the largest entry
    added to the diagonal, which separates equal eigenvalues.
    """
    try:
        values, vectors = torch.linalg.eigh(matrix)
        if bool(values.isfinite().all() & vectors.isfinite().all()):
            return values, vectors
    except torch.linalg.LinAlgError:
        pass  # the same remedy as for NaN
    finer = matrix.double()
    ramp = torch.linspace(0, SPLIT, matrix.shape[-1], dtype=finer.dtype, device=finer.device)
    largest = finer.abs().amax(dim=(-2, -1), keepdim=True)[..., 0]
    values, vectors = torch.linalg.eigh(finer + torch.diag_embed(largest * ramp))
    return values.to(matrix.dtype), vectors.to(matrix.dtype)
