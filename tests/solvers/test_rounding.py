"""Rounding keeps every constraint and moves U as little as it can."""

import itertools

import torch

from mixer_torch.solvers.gradient.batch import Batch
from mixer_torch.solvers.gradient.rounding import binary_labels, nearest_labels


def test_nearest_against_all_assignments_of_a_view():
    generator = torch.Generator().manual_seed(0)
    apart = ~torch.eye(3, dtype=torch.bool)
    for _ in range(20):
        U = torch.rand(3, 4, generator=generator) * torch.randint(0, 2, (3, 4), generator=generator)
        labels = nearest_labels(U, apart)
        assert len(labels.unique()) == 3
        wide = torch.cat([U, torch.zeros(3, 3)], 1)  # with a fresh column for each
        choices = itertools.permutations(range(7), 3)
        distance = {
            c: (torch.nn.functional.one_hot(torch.tensor(c), 7) - wide).square().sum()
            for c in choices
        }
        got = tuple(min(int(label), 6) if label < 4 else 4 + i for i, label in enumerate(labels))
        assert distance[got] <= min(distance.values()) + 1e-6


def test_nearest_gives_a_row_of_zeros_a_column_of_its_own():
    labels = nearest_labels(torch.tensor([[0.0, 0.0], [0.0, 1.0]]), torch.zeros(2, 2) > 0)
    assert labels[0] != labels[1]


def test_nearest_where_conflicts_are_no_cliques():
    apart = torch.zeros(3, 3, dtype=torch.bool)
    apart[0, 1] = apart[1, 0] = apart[1, 2] = apart[2, 1] = True
    U = torch.tensor([[0.8, 0.2], [0.9, 0.3], [0.7, 0.1]])
    labels = nearest_labels(U, apart)
    # Row 1 is the surest and takes column 0; the others, which may be together, the next best.
    assert labels.tolist() == [1, 0, 1]


def test_binary_labels_tell_what_needs_no_rounding():
    U = torch.tensor(
        [[[1.0, 0], [0, 1], [0, 0]], [[1, 0], [1, 0], [0, 1]], [[0.5, 0.5], [0, 1], [1, 0]]]
    )
    distinctness = torch.zeros(3, 3, 3)
    distinctness[1, 0, 1] = distinctness[1, 1, 0] = 1
    mask = torch.tensor([[True, True, False], [True, True, True], [True, True, True]])
    labels, binary = binary_labels(U, Batch(torch.zeros(3, 3, 3), distinctness, mask))
    assert binary.tolist() == [True, False, False]
    assert labels[0, :2].tolist() == [0, 1]
