"""MatchEIG, worked by hand."""

import pytest
import torch

import mixer_torch as mx
from mixer_torch.solvers.matcheig import MatchEIG

CHAIN = mx.Affinity.from_dense(torch.tensor([[1.0, 1, 0], [1, 1, 1], [0, 1, 1]]), [0, 1, 2])


def test_completes_a_chain():
    # W + I has the leading eigenvalue 1 + √2 with eigenvector (1, √2, 1) / 2, so that
    # X_ab = (1 + √2) √2 / 4 = 0.854 and X_ac = (1 + √2) / 4 = 0.604.
    association = mx.solve(CHAIN, MatchEIG(universe=1))
    assert association.labels.tolist() == [0, 0, 0]


@pytest.mark.parametrize(("threshold", "closed"), [(0.60, True), (0.61, False)])
def test_links_where_blocks_disagree(threshold, closed):
    association = mx.solve(CHAIN, MatchEIG(universe=1, threshold=threshold))
    assert (association.labels is not None) == closed
    if not closed:
        assert association.links.T.tolist() == [[0, 1], [1, 2]]
        assert association.status is mx.Status.INCONSISTENT


def test_blocks_are_one_to_one():
    view = torch.tensor([0, 1, 1])
    scores = torch.tensor([[1.0, 1, 1], [1, 1, 0], [1, 0, 1]])
    association = mx.solve(mx.Affinity.from_dense(scores, view), MatchEIG())
    assert association.links.shape == (2, 1)
