"""Eigendecomposition where LAPACK gives up."""

import pytest
import torch

from mixer_torch.solvers.eigen import eigh


def few_entries(seed, m=40):
    """A symmetric matrix of three different entries, as named colours make them."""
    colour = torch.randint(0, 4, (m,), generator=torch.Generator().manual_seed(seed))
    matrix = 1 - 2 * (colour[:, None] == colour).float()
    matrix[colour == 0] = 0
    matrix[:, colour == 0] = 0
    return matrix


@pytest.mark.parametrize("fails", ["not", "raises", "nan"])
@pytest.mark.parametrize("batch", [(), (3,)])
def test_decomposes_also_where_float32_does_not_converge(monkeypatch, fails, batch):
    real = torch.linalg.eigh

    def stubborn(matrix):
        if matrix.dtype == torch.float32 and fails == "raises":
            raise torch.linalg.LinAlgError("the algorithm failed to converge")
        values, vectors = real(matrix)
        return values, vectors * (torch.nan if matrix.dtype == torch.float32 else 1)

    if fails != "not":
        monkeypatch.setattr(torch.linalg, "eigh", stubborn)
    matrix = few_entries(0).expand(*batch, -1, -1)
    values, vectors = eigh(matrix)
    assert values.dtype == vectors.dtype == torch.float32
    torch.testing.assert_close(
        vectors @ torch.diag_embed(values) @ vectors.mT, matrix, atol=1e-4, rtol=0
    )
    unit = torch.eye(40).expand(*batch, -1, -1)
    torch.testing.assert_close(vectors.mT @ vectors, unit, atol=1e-4, rtol=0)
    assert bool((values.diff() >= 0).all())


def test_empty():
    values, vectors = eigh(torch.zeros(0, 0))
    assert values.shape == (0,)
    assert vectors.shape == (0, 0)
