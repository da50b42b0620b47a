"""The compiled projection against the one that sorts."""

import pytest
import torch

from mixer_torch.solvers.gradient.projection import project_rows
from mixer_torch.solvers.gradient.relaxation import (
    project_to_row_sum_at_most_one,
    project_to_simplex,
)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_same_as_by_sorting(dtype, scale):
    generator = torch.Generator().manual_seed(0)
    rows = scale * torch.randn(4, 20, 9, generator=generator, dtype=dtype)
    rows[0, :3] = torch.tensor([[0.0] * 9, [2.0] * 9, [-1.0] * 9])  # ties
    keep = torch.rand(4, 20, generator=generator) > 0.2
    at_most = torch.tensor([True, False, True, False])
    expected = torch.where(
        at_most[:, None, None], project_to_row_sum_at_most_one(rows), project_to_simplex(rows)
    )
    got = project_rows(rows.clone(), keep, at_most)
    assert got.dtype == dtype
    torch.testing.assert_close(got, expected * keep[..., None], atol=1e-5 * max(scale, 1), rtol=0)


def test_one_column_and_no_room_for_doubt():
    rows = torch.tensor([[[-3.0], [0.2], [7.0]]])
    assert project_rows(rows, torch.ones(1, 3) > 0).flatten().tolist() == [1, 1, 1]
