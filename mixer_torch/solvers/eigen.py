"""Eigenvalues of symmetric matrices, also where LAPACK does not converge."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

SPLIT = 1e-9  # of the largest entry: far above the rounding of float64, below that of float32
# Observations up to which all eigenvalues are found about as fast as the extreme ones.
SMALL = 128
# Steps of Lanczos' method: after 16 the extreme eigenvalues are known to about a hundredth of the
# width of the spectrum, which tests/solvers/test_batch.py checks.
LANCZOS_STEPS = 16
NO_LENGTH = 1e-6  # of a vector that is linearly dependent on those before, by rounding in float32


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


def extreme_eigenvalues(
    matrix: Float[Tensor, "B m m"], seed: int = 0
) -> tuple[Float[Tensor, " B"], Float[Tensor, " B"]]:
    """Least and largest eigenvalue of symmetric matrices.

    Exact for small ones; of large ones by a few steps of Lanczos' method, good to about a hundredth
    of the spectrum's width, from the inside.
    """
    B, m, _ = matrix.shape
    if m <= SMALL:
        spectrum = torch.linalg.eigvalsh(matrix)
        return spectrum[:, 0], spectrum[:, -1]
    steps = min(LANCZOS_STEPS, m)
    generator = torch.Generator(device=matrix.device).manual_seed(seed)
    first = torch.randn(m, generator=generator, dtype=matrix.dtype, device=matrix.device)
    basis = matrix.new_zeros(B, steps, m)
    basis[:, 0] = first / first.norm()
    for i in range(steps - 1):
        vector = (matrix @ basis[:, i, :, None])[..., 0]
        for _ in range(2):  # once more, for what rounding left of the first time
            inside = basis[:, : i + 1]
            vector = vector - (inside.mT @ (inside @ vector[..., None]))[..., 0]
        length = vector.norm(dim=1, keepdim=True)
        basis[:, i + 1] = torch.where(length > NO_LENGTH, vector / length.clamp(min=NO_LENGTH), 0)
    ritz = torch.linalg.eigvalsh(basis @ matrix @ basis.mT)
    return ritz[:, 0], ritz[:, -1]
