"""Greedy contraction: against the same rule written out on a full matrix."""

import numpy as np
import pytest

from mixer_torch.solvers.search.graph import Graph
from mixer_torch.solvers.search.greedy import greedy


def by_matrix(cost: np.ndarray, view: np.ndarray) -> list[list[int]]:
    """Join the pair of compatible clusters with the most negative cost until there is none."""
    clusters = [[i] for i in range(len(view))]
    while True:
        best, pair = 0.0, None
        for a in range(len(clusters)):
            for b in range(a):
                total = cost[np.ix_(clusters[a], clusters[b])].sum()
                views = view[clusters[a] + clusters[b]]
                if total < best and len(set(views.tolist())) == len(views):
                    best, pair = total, (a, b)
        if pair is None:
            return sorted(sorted(cluster) for cluster in clusters)
        clusters[pair[1]] += clusters.pop(pair[0])


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("views", [1, 4, 20])
def test_joins_as_the_rule_says(seed: int, views: int) -> None:
    rng = np.random.default_rng(seed)
    n = 20
    upper = np.triu(rng.normal(size=(n, n)) - 0.2, 1)
    view = rng.integers(0, views, n) if views < n else np.arange(n)
    cost = np.where(view[:, None] == view, 0.0, upper + upper.T)
    pairs = np.stack(np.triu_indices(n, 1))
    graph = Graph.from_arrays(n, pairs, cost[tuple(pairs)], np.stack([np.arange(n), view]))
    label = greedy(graph)
    found = sorted(np.flatnonzero(label == c).tolist() for c in np.unique(label))
    assert found == by_matrix(cost, view)
    assert all(label[c] == c for c in np.unique(label))


def test_all_attract_and_all_repel_and_nothing() -> None:
    n = 40
    pairs = np.stack(np.triu_indices(n, 1))
    apart = np.zeros((2, 0), int)
    all_attract = Graph.from_arrays(n, pairs, np.full(pairs.shape[1], -1.0), apart)
    assert (greedy(all_attract) == 0).all()
    all_repel = Graph.from_arrays(n, pairs, np.full(pairs.shape[1], 1.0), apart)
    assert (greedy(all_repel) == np.arange(n)).all()
    assert len(greedy(Graph.from_arrays(0, apart, np.zeros(0), apart))) == 0
