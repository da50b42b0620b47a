"""Small parts against all of their clusterings, one after the other."""

import numpy as np
import pytest
from enumeration import optimum

from mixer_torch.solvers.refinement import refine
from mixer_torch.solvers.search.decomposition import decompose
from mixer_torch.solvers.search.exhaustive import LARGEST, enumerate_parts
from mixer_torch.solvers.search.graph import Graph


def side_by_side(sizes, seed, groups):
    """Random parts of given sizes in one graph, with their dense costs and forbidden pairs."""
    rng = np.random.default_rng(seed)
    blocks, n = [], sum(sizes)
    cost, group, start = np.zeros((n, n)), np.empty(n, np.int64), 0
    for size in sizes:
        own = slice(start, start + size)
        group[own] = rng.integers(0, groups, size) + 100 * start
        block = np.triu(rng.normal(size=(size, size)), 1)
        conflict = (group[own][:, None] == group[own]) & ~np.eye(size, dtype=bool)
        block[conflict] = 0
        cost[own, own] = block
        blocks.append((block + block.T, conflict))
        start += size
    order = rng.permutation(n)  # parts need not be in one piece
    pairs = np.stack(np.nonzero(cost))
    graph = Graph.from_arrays(
        n, order[pairs], cost[pairs[0], pairs[1]], np.stack([order[np.arange(n)], group])
    )
    return graph, blocks


@pytest.mark.parametrize("groups", [3, 50])
@pytest.mark.parametrize("seed", range(5))
def test_no_clustering_of_small_parts_is_better(seed, groups):
    graph, blocks = side_by_side([1, 2, 3, 5, 7, 8, 8], seed, groups)
    label = np.arange(len(graph))
    parts = decompose(graph)
    changed = enumerate_parts(graph, parts, label)
    assert graph.is_feasible(label)
    assert changed.shape == (len(parts),)
    assert graph.objective(label) == pytest.approx(changed.sum())
    assert changed.sum() == pytest.approx(sum(optimum(*block) for block in blocks))


def test_the_largest_is_as_good_as_a_long_search_and_larger_ones_are_left():
    for size in (LARGEST, LARGEST + 1):
        graph, _ = side_by_side([size], 4, 5)
        parts, label = decompose(graph), np.arange(size)
        assert len(parts) == 1
        changed = enumerate_parts(graph, parts, label)
        if size == LARGEST:
            _, stats = refine(graph, restarts=500)
            assert changed[0] == pytest.approx(stats["objective"])
            assert graph.objective(label) == pytest.approx(changed[0])
        else:
            assert changed[0] == 0
            assert label.tolist() == list(range(size))


def test_labels_are_kept_where_nothing_is_better():
    graph = Graph.from_arrays(4, [[0, 1, 2], [1, 2, 3]], [-1.0, 1.0, -2.0], np.zeros((2, 0), int))
    label = np.array([1, 1, 2, 2])
    assert not enumerate_parts(graph, decompose(graph), label).any()
    assert label.tolist() == [1, 1, 2, 2]
