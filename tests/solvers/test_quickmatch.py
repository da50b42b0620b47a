"""QuickMatch: density, tree and merging, each against a plain loop or by hand."""

import math

import pytest
import torch

import mixer_torch as mx
from mixer_torch.solvers.problem import is_distinct, problem_of
from mixer_torch.solvers.quickmatch import QuickMatch, density, feature_distance, merge, tree


def points(seed, m=12):
    position = torch.rand(m, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.cdist(position, position)


def test_distances_are_those_of_unit_vectors():
    vectors = torch.nn.functional.normalize(
        torch.rand(6, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64), dim=1
    )
    affinity = mx.Affinity.from_dense((vectors @ vectors.T).clamp(0, 1), torch.arange(6))
    distance = feature_distance(problem_of(affinity))
    expected = torch.cdist(vectors, vectors)
    torch.testing.assert_close(distance, expected, atol=1e-6, rtol=0)


def test_distance_within_a_view_and_of_what_is_not_listed():
    pairs, view = torch.tensor([[0], [1]]), torch.tensor([0, 1, 1])
    affinity = mx.Affinity(pairs, torch.tensor([[1.0]]), view, ("one",))
    distance = feature_distance(problem_of(affinity))
    expected = torch.tensor([[0, 0, 1], [0, 0, math.sqrt(2)], [1, math.sqrt(2), 0]])
    torch.testing.assert_close(distance, expected)


def test_density_by_a_loop():
    distance = points(0)
    width = torch.linspace(0.1, 0.4, 12, dtype=torch.float64)
    expected = [
        sum(math.exp(-(float(distance[a, b]) ** 2) / (2 * float(width[b]) ** 2)) for b in range(12))
        for a in range(12)
    ]
    assert density(distance, width).tolist() == pytest.approx(expected)


def test_tree_by_a_loop():
    distance = points(1)
    height = density(distance, torch.full((12,), 0.2, dtype=torch.float64))
    parent, length = tree(distance, height)
    for a in range(12):
        higher = [b for b in range(12) if height[b] > height[a]]
        if higher:
            nearest = min(higher, key=lambda b: float(distance[a, b]))
            assert (int(parent[a]), float(length[a])) == (nearest, float(distance[a, nearest]))
        else:
            assert int(parent[a]) == a
            assert math.isinf(float(length[a]))


def test_equal_densities_still_make_one_tree():
    parent, length = tree(torch.zeros(5, 5), torch.ones(5))
    assert int(length.isinf().sum()) == 1
    assert bool((parent <= torch.arange(5)).all())


def test_merging_by_hand():
    # The tree 3 -> 2 -> 1 -> 0, and 4 -> 0. Edge 4-0 is too long; 3 shares a view with 1.
    parent = torch.tensor([0, 0, 1, 2, 0])
    length = torch.tensor([math.inf, 0.1, 0.2, 0.3, 0.8])
    view = torch.tensor([0, 1, 2, 1, 3])
    labels = merge(parent, length, torch.full((5,), 0.7), view)
    assert len(labels.unique()) == 3
    assert labels[0] == labels[1] == labels[2]


def test_the_tightest_scale_in_a_cluster_rules():
    parent = torch.tensor([0, 0, 1])
    length = torch.tensor([math.inf, 0.1, 0.5])
    view = torch.tensor([0, 1, 2])
    assert len(merge(parent, length, torch.tensor([0.6, 0.6, 0.6]), view).unique()) == 1
    assert len(merge(parent, length, torch.tensor([0.4, 0.6, 0.6]), view).unique()) == 2


@pytest.mark.parametrize(("score", "clusters"), [(0.56, 1), (0.54, 2), (0.5, 2)])
def test_the_authors_ratio_merges_above_055(score, clusters):
    affinity = mx.Affinity.from_dense(torch.full((2, 2), score), [0, 1])
    assert mx.solve(affinity, QuickMatch()).num_clusters == clusters


def test_distinct_even_where_everything_looks_the_same():
    view = torch.arange(4).repeat_interleave(3)
    association = mx.solve(mx.Affinity.from_dense(torch.ones(12, 12), view), QuickMatch())
    assert is_distinct(association.labels, view)
    assert association.num_clusters >= 3
