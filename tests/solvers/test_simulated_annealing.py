"""Annealing: the bookkeeping of the cost, feasibility, and the heat bath's distribution."""

import numpy as np
import pytest

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.search.clustering import build
from mixer_torch.solvers.search.graph import Graph
from mixer_torch.solvers.search.simulated_annealing import anneal


@compiled
def annealed(weight, group_start, group, label, hot, cold, sweeps, random):
    state = build(weight, group_start, group, label)
    change = anneal(state, np.arange(len(label)), len(label), hot, cold, sweeps, random)
    drift = 0.0
    for c in range(len(label) + 1):
        for i in range(len(label)):
            total = 0.0
            for j in range(len(label)):
                if state.label[j] == c:
                    total += weight[i, j]
            drift = max(drift, abs(total - state.total[c, i]))
    return state.label.copy(), change, drift


def graph_and_matrix(seed: int, n: int, groups: int, each: int) -> tuple[Graph, np.ndarray]:
    rng = np.random.default_rng(seed)
    pairs = np.stack(np.triu_indices(n, 1))
    incidence = np.stack([np.repeat(np.arange(n), each), rng.integers(0, groups, n * each)])
    graph = Graph.from_arrays(n, pairs, rng.normal(size=pairs.shape[1]), incidence)
    weight = np.zeros((n, n))
    weight[np.repeat(np.arange(n), np.diff(graph.start)), graph.neighbour] = graph.cost
    return graph, weight


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("groups", "each"), [(1000, 1), (6, 1), (40, 3)])
def test_cost_is_kept_track_of_and_constraints_hold(seed: int, groups: int, each: int) -> None:
    graph, weight = graph_and_matrix(seed, 30, groups, each)
    start = np.arange(30)
    random = np.array([seed], np.uint64)
    label, change, drift = annealed(
        weight, graph.group_start, graph.group, start, 2.0, 0.2, 20, random
    )
    assert graph.is_feasible(label)
    assert np.isclose(graph.objective(label) - graph.objective(start), change, atol=1e-9)
    assert drift < 1e-9
    assert (label != start).any()


def test_two_nodes_are_together_as_often_as_boltzmann_says() -> None:
    cost, temperature = -0.7, 1.0
    weight = np.array([[0.0, cost], [cost, 0.0]])
    none, empty = np.zeros(3, np.int64), np.zeros(0, np.int32)
    random = np.array([7], np.uint64)
    together = 0
    for _ in range(4000):
        start = np.array([0, 1])
        label, _, _ = annealed(weight, none, empty, start, temperature, temperature, 3, random)
        together += label[0] == label[1]
    expected = np.exp(-cost / temperature) / (1 + np.exp(-cost / temperature))
    assert abs(together / 4000 - expected) < 5 * np.sqrt(expected * (1 - expected) / 4000)


def test_nodes_of_one_token_swap_places() -> None:
    """Each of two nodes sits where the other belongs, and both clusters hold their group."""
    n = 4
    weight = np.zeros((n, n))
    weight[0, 2] = weight[2, 0] = weight[1, 3] = weight[3, 1] = -1.0
    group_start, group = np.array([0, 1, 2, 3, 4]), np.array([0, 0, 1, 1], np.int32)
    start = np.array([0, 1, 1, 0])
    random = np.array([3], np.uint64)
    label, change, _ = annealed(weight, group_start, group, start, 0.05, 0.05, 5, random)
    assert change == -2.0
    assert label[0] == label[2] != label[1] == label[3]
