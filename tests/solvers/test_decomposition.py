"""Parts: against scipy's components, and against brute force on the claim that they are exact."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mixer_torch.solvers.search.decomposition import cut_along, decompose
from mixer_torch.solvers.search.graph import Graph


def random_graph(seed: int, n: int, share: float) -> tuple[Graph, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    pairs = np.stack(np.triu_indices(n, 1))
    pairs = pairs[:, rng.random(pairs.shape[1]) < share]
    cost = rng.normal(size=pairs.shape[1]) + 0.5
    return Graph.from_arrays(n, pairs, cost, np.zeros((2, 0), int)), pairs, cost


@pytest.mark.parametrize("seed", range(5))
def test_parts_are_the_components_of_negative_costs(seed: int) -> None:
    graph, pairs, cost = random_graph(seed, 60, 0.05)
    attract = pairs[:, cost < 0]
    matrix = coo_array((np.ones(attract.shape[1]), tuple(attract)), shape=(60, 60))
    count, component = connected_components(matrix, directed=False)
    parts = decompose(graph)
    assert len(parts) == count
    assert len({*zip(component.tolist(), parts.part.tolist(), strict=True)}) == count
    for p in range(count):
        members = parts.order[parts.start[p] : parts.start[p + 1]]
        assert (members == np.flatnonzero(parts.part == p)).all()


@pytest.mark.parametrize("seed", range(20))
def test_cutting_along_parts_never_costs_more(seed: int) -> None:
    graph, _, _ = random_graph(seed, 30, 0.1)
    label = np.random.default_rng(seed).integers(0, 5, 30)
    parts = decompose(graph)
    cut = cut_along(label, parts)
    assert graph.objective(cut) <= graph.objective(label) + 1e-12
    costs = graph.objective_by_part(cut, parts.part, len(parts))
    assert np.isclose(costs.sum(), graph.objective(cut))
    for c in np.unique(cut):
        assert len(np.unique(label[cut == c])) == 1
        assert len(np.unique(parts.part[cut == c])) == 1
