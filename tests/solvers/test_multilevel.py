"""Large graphs: the cost is kept track of, constraints hold, and nothing gets worse."""

import numpy as np
import pytest

from mixer_torch.solvers import refinement
from mixer_torch.solvers.search.graph import Graph, arrays_of, compact
from mixer_torch.solvers.search.greedy import greedy
from mixer_torch.solvers.search.iterated_local_search import RESTARTS, new_search_state
from mixer_torch.solvers.search.multilevel import refine_large
from mixer_torch.solvers.search.subproblem import Labelling, search_subproblem


def video(seed: int, frames: int, objects: int, window: int = 3) -> Graph:
    """Objects seen in each frame, pairs within a window of frames, noisy costs."""
    rng = np.random.default_rng(seed)
    n = frames * objects
    frame = np.arange(n) // objects
    identity = np.concatenate([rng.permutation(objects) for _ in range(frames)])
    pairs = np.stack(np.triu_indices(n, 1))
    gap = frame[pairs[1]] - frame[pairs[0]]
    pairs = pairs[:, (gap > 0) & (gap <= window)]
    same = identity[pairs[0]] == identity[pairs[1]]
    cost = np.where(same, -0.4, 0.4) + 0.5 * rng.normal(size=len(same))
    return Graph.from_arrays(n, pairs, cost, np.stack([np.arange(n), frame]))


@pytest.mark.parametrize("seed", range(3))
def test_feasible_and_not_worse_than_greedy(seed: int) -> None:
    graph = video(seed, 40, 8)
    start = greedy(graph)
    random = np.array([seed], np.uint64)
    label, state = refine_large(graph, start, 10, random, np.inf)
    assert state[RESTARTS] > 0
    assert graph.is_feasible(label)
    assert graph.objective(label) < graph.objective(start)


def test_close_to_the_search_of_the_whole() -> None:
    graph = video(5, 30, 8)
    start = greedy(graph)
    whole, _ = refinement.refine(graph, start, restarts=100)
    label, _ = refine_large(graph, start, 20, np.array([1], np.uint64), np.inf)
    assert graph.objective(label) <= 0.99 * graph.objective(whole)


def test_out_of_time_returns_the_start() -> None:
    graph = video(1, 20, 6)
    start = greedy(graph)
    label, state = refine_large(graph, start, 10, np.array([0], np.uint64), -np.inf)
    assert state[RESTARTS] == 0
    assert (label == compact(start)).all()


@pytest.mark.parametrize("seed", range(6))
def test_subproblems_leave_the_rest_together(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = video(seed, 20, 6)
    before = compact(greedy(graph))
    labelling = Labelling.of(graph, before.copy())
    random = np.array([seed], np.uint64)
    cost = graph.objective(before)
    for _ in range(5):
        old = labelling.label.copy()
        nodes = np.sort(rng.choice(len(graph), 25, replace=False)).astype(np.int64)
        search_subproblem(
            arrays_of(graph),
            graph.members(),
            labelling,
            nodes,
            10,
            new_search_state(10),
            np.zeros(len(nodes)),
            random,
        )
        rest = np.setdiff1d(np.arange(len(graph)), nodes)
        assert (labelling.label[rest] == old[rest]).all()
        assert graph.is_feasible(labelling.label)
        now = graph.objective(labelling.label)
        assert now <= cost + 1e-9
        cost = now
        size = np.bincount(labelling.label, minlength=len(graph))
        assert (labelling.size == size).all()
        unused = labelling.unused[: labelling.height[0]]
        assert sorted(unused.tolist()) == np.flatnonzero(size == 0).tolist()


def test_large_parts_are_refined_without_a_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refinement, "DENSE", 50)
    graph = video(2, 30, 8)
    label, stats = refinement.refine(graph, greedy(graph), restarts=50)
    again, _ = refinement.refine(graph, greedy(graph), restarts=50)
    assert graph.is_feasible(label)
    assert stats["objective"] < stats["start"]
    assert np.isclose(graph.objective(label), stats["objective"])
    assert (label == again).all()


def test_large_parts_with_most_pairs_listed_are_searched_as_a_matrix(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    called = []

    def refine_by_subproblems(graph, label, restarts, random, deadline, progress=None):
        called.append(len(graph))
        return refine_large(graph, label, restarts, random, deadline, progress)

    monkeypatch.setattr(refinement, "refine_large", refine_by_subproblems)
    sparse, full = video(2, 30, 8), video(2, 30, 8, window=30)
    by_subproblems = refine_large(full, greedy(full), 5, np.array([0], np.uint64), np.inf)[0]
    monkeypatch.setattr(refinement, "DENSE", 50)
    label, _ = refinement.refine(full, greedy(full), restarts=5)
    assert not called
    assert full.is_feasible(label)
    assert full.objective(label) <= full.objective(by_subproblems) + 1e-9
    refinement.refine(sparse, greedy(sparse), restarts=5)
    assert called
