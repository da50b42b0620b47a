"""The graph of nodes with groups: against sums worked out pair by pair."""

import numpy as np
import torch

from mixer_torch.solvers.problem import Problem, objective_of
from mixer_torch.solvers.search.graph import Graph, compact, named_by_member


def test_costs_of_a_repeated_pair_add_and_conflicts_are_no_edges() -> None:
    pairs = np.array([[0, 1, 0, 3], [1, 0, 2, 4]])
    groups = np.array([[0, 2, 3], [7, 7, 9]])
    graph = Graph.from_arrays(5, pairs, np.array([1.0, 2.0, -1.0, 3.0]), groups)
    assert graph.neighbour.tolist() == [1, 0, 4, 3]  # (0, 2) share the group 7
    assert graph.cost.tolist() == [3.0, 3.0, 3.0, 3.0]
    assert graph.group.tolist() == [0, 0]  # only node 3 is in 9


def test_contraction_keeps_the_cost_of_every_clustering_above_it() -> None:
    rng = np.random.default_rng(0)
    n = 12
    pairs = np.stack(np.triu_indices(n, 1))
    cost = rng.normal(size=pairs.shape[1])
    groups = np.stack([np.arange(n), np.arange(n) // 2])
    graph = Graph.from_arrays(n, pairs, cost, groups)
    label = np.array([0, 1, 0, 1, 2, 3, 2, 3, 4, 5, 4, 5])
    coarse = graph.contract(label)
    assert len(coarse) == 6
    assert coarse.group_start.tolist() == [0, 2, 4, 6, 8, 10, 12]
    for above in ([0, 1, 2, 3, 4, 5], [0, 1, 0, 1, 0, 1], [0, 1, 1, 0, 2, 3]):
        whole = np.array(above)[label]
        assert graph.is_feasible(whole)
        inside = graph.objective(label) + coarse.objective(np.array(above))
        assert np.isclose(graph.objective(whole), inside)
    assert not coarse.is_feasible(np.array([0, 0, 1, 2, 3, 4]))


def test_subgraph_is_the_graph_of_its_nodes() -> None:
    rng = np.random.default_rng(1)
    pairs = np.stack(np.triu_indices(9, 1))
    cost = rng.normal(size=pairs.shape[1])
    graph = Graph.from_arrays(9, pairs, cost, np.stack([np.arange(9), np.arange(9) % 3]))
    nodes = np.array([0, 2, 3, 7])
    own = graph.subgraph(nodes)
    label = np.array([0, 0, 1, 1])
    whole = np.arange(9) + 9
    whole[nodes] = label
    assert np.isclose(own.objective(label), graph.objective(whole))
    assert not own.is_feasible(np.array([0, 1, 0, 2]))


def test_problems_side_by_side_add_up() -> None:
    view = torch.tensor([0, 1, 0])
    cost = torch.tensor([-1.0, 0.5])
    problem = Problem(torch.tensor([[0, 1], [1, 2]]), cost, view, (1 - cost) / 2)
    graph = Graph.from_problems([problem, problem])
    label = torch.tensor([0, 0, 1])
    both = np.array([0, 0, 1, 2, 2, 3])
    assert graph.objective(both) == 2 * objective_of(problem, label)
    assert graph.is_feasible(both)
    assert graph.is_feasible(np.array([0, 1, 2, 0, 1, 2]))  # views of two problems are different
    assert not graph.is_feasible(np.array([0, 1, 0, 2, 3, 4]))


def test_labels_are_renumbered() -> None:
    assert compact(np.array([7, 3, 7])).tolist() == [1, 0, 1]
    assert named_by_member(np.array([7, 3, 7])).tolist() == [0, 1, 0]
    assert Graph.from_problems([]).objective(np.zeros(0, int)) == 0
