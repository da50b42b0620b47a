"""CLEAR: its Laplacian, pivots and assignment, each against a second formulation."""

from itertools import permutations

import numpy as np
import torch

import mixer_torch as mx
from mixer_torch.solvers.clear import Clear, assign, pivots
from mixer_torch.solvers.synchronization import normalized_laplacian


def test_laplacian_edge_by_edge():
    generator = np.random.default_rng(0)
    weight = np.triu(generator.random((6, 6)), 1)
    weight = weight + weight.T
    degree = weight.sum(1)
    expected = np.zeros((6, 6))
    for a in range(6):
        expected[a, a] = degree[a] / (degree[a] + 1)
        for b in range(6):
            if a != b:
                expected[a, b] = -weight[a, b] / np.sqrt((degree[a] + 1) * (degree[b] + 1))
    actual = normalized_laplacian(torch.from_numpy(weight))
    np.testing.assert_allclose(actual.numpy(), expected, atol=1e-12)


def test_spectrum_of_noiseless_matches_is_zero_and_one():
    identity = torch.tensor([0, 0, 0, 1, 1, 2])
    weight = (identity[:, None] == identity).double().fill_diagonal_(0)
    values = torch.linalg.eigvalsh(normalized_laplacian(weight))
    expected = torch.tensor([0.0, 0, 0, 1, 1, 1], dtype=torch.float64)
    torch.testing.assert_close(values, expected)


def test_one_pivot_an_object():
    identity = torch.tensor([2, 0, 0, 1, 2, 1, 3, 0])
    rows = (
        torch.eye(4, dtype=torch.float64)[identity]
        @ torch.linalg.qr(
            torch.randn(4, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
        )[0]
    )
    assert sorted(identity[pivots(rows)].tolist()) == [0, 1, 2, 3]
    assert pivots(rows)[0] == 0


def test_assignment_against_enumeration():
    generator = torch.Generator().manual_seed(0)
    view = torch.tensor([0, 1, 0, 1, 0])
    for _ in range(10):
        distance = torch.rand(5, 4, generator=generator, dtype=torch.float64)
        labels = assign(distance, view)
        for value in (0, 1):
            rows = (view == value).nonzero()[:, 0]
            costs = [
                float(distance[rows, list(columns)].sum())
                for columns in permutations(range(4), len(rows))
            ]
            found = float(distance[rows, labels[rows]].sum())
            assert abs(found - min(costs)) < 1e-12


def test_missing_matches_within_an_object_are_filled_in():
    identity = torch.arange(3).repeat(6)
    view = torch.arange(6).repeat_interleave(3)
    scores = (identity[:, None] == identity).double()
    gone = torch.rand(18, 18, generator=torch.Generator().manual_seed(0)).triu(1) > 0.75
    unsaid = torch.where(gone | gone.T, torch.tensor(0.5, dtype=torch.float64), scores)
    association = mx.solve(mx.Affinity.from_dense(unsaid, view), Clear())
    assert torch.equal(association.labels, identity)
    assert association.stats["universe"] == 3
