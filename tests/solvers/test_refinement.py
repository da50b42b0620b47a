"""Refinement: against enumeration of all clusterings, and by what it promises."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mixer_torch.solvers.problem import Problem, is_distinct, objective_of
from mixer_torch.solvers.refinement import Effort, refine, refine_parts, restarts_of, summary
from mixer_torch.solvers.search.decomposition import decompose
from mixer_torch.solvers.search.graph import Graph
from mixer_torch.solvers.search.greedy import greedy


def partitions(n: int) -> Iterator[np.ndarray]:
    """All set partitions of n things, as restricted growth strings."""

    def extend(prefix: list[int], top: int) -> Iterator[np.ndarray]:
        if len(prefix) == n:
            yield np.array(prefix, int)
            return
        for c in range(top + 1):
            yield from extend([*prefix, c], max(top, c + 1))

    yield from extend([], 0)


def random_graph(seed: int, n: int, tokens: int, each: int = 1) -> Graph:
    rng = np.random.default_rng(seed)
    pairs = np.stack(np.triu_indices(n, 1))
    cost = rng.normal(size=pairs.shape[1]) - 0.3
    incidence = np.stack([np.repeat(np.arange(n), each), rng.integers(0, tokens, n * each)])
    return Graph.from_arrays(n, pairs, cost, incidence)


def random_problem(seed: int, m: int, views: int, dtype: torch.dtype = torch.float64) -> Problem:
    generator = torch.Generator().manual_seed(seed)
    view = torch.randint(0, views, (m,), generator=generator)
    pairs = torch.triu_indices(m, m, 1)
    pairs = pairs[:, view[pairs[0]] != view[pairs[1]]]
    cost = torch.randn(pairs.shape[1], generator=generator, dtype=dtype)
    return Problem(pairs, cost, view, (1 - cost) / 2)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(("tokens", "each"), [(1000, 1), (3, 1), (9, 2)])
def test_reaches_the_optimum_of_all_clusterings(seed: int, tokens: int, each: int) -> None:
    graph = random_graph(seed, 7, tokens, each)
    best = min(graph.objective(p) for p in partitions(7) if graph.is_feasible(p))
    label, stats = refine(graph, seed=seed)
    assert graph.is_feasible(label)
    assert np.isclose(stats["objective"], best, rtol=0, atol=1e-9)
    assert np.isclose(graph.objective(label), stats["objective"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("restarts", [0, 5])
@pytest.mark.parametrize(("tokens", "each"), [(6, 1), (60, 3)])
def test_never_worse_than_its_start(restarts: int, tokens: int, each: int) -> None:
    for seed in range(10):
        graph = random_graph(seed, 40, tokens, each)
        start, _ = refine(graph, restarts=0, seed=seed)
        label, stats = refine(graph, start, restarts=restarts, seed=seed)
        assert graph.is_feasible(label)
        assert stats["objective"] <= stats["start"]
        assert stats["start"] == graph.objective(start)


def test_many_nodes_with_several_tokens_stay_feasible() -> None:
    graph = random_graph(3, 120, 200, 4)
    label, stats = refine(graph, restarts=30)
    assert graph.is_feasible(label)
    assert np.isclose(graph.objective(label), stats["objective"])


def test_same_seed_same_labels() -> None:
    graph = random_graph(1, 60, 12)
    first, _ = refine(graph, restarts=20, seed=4)
    second, _ = refine(graph, restarts=20, seed=4)
    assert (first == second).all()


def test_bad_starts_are_refused() -> None:
    graph = random_graph(0, 6, 2)
    with pytest.raises(ValueError, match="share a cannot-link group"):
        refine(graph, np.zeros(6, int))
    with pytest.raises(ValueError, match="labels: expected shape"):
        refine(graph, np.zeros(5, int))


def test_no_time_still_gives_a_feasible_answer() -> None:
    graph = random_graph(0, 200, 10)
    label, stats = refine(graph, greedy(graph), time_limit=0.0, restarts=10**6)
    assert stats["timed_out"]
    assert graph.is_feasible(label)
    assert stats["objective"] <= stats["start"]


def test_progress_stays_within_one() -> None:
    told: list[float] = []
    graph = Graph.from_problems([random_problem(seed, 30, 5) for seed in range(800)])
    refine(graph, restarts=1, progress=told.append)
    assert told
    assert told == sorted(told)
    assert told[-1] <= 1


def test_side_by_side_answers_as_each_alone() -> None:
    problems = [random_problem(seed, 5 + 4 * seed, 1 + seed) for seed in range(6)]
    key = np.concatenate([np.arange(len(problem)) for problem in problems])
    graph, effort = Graph.from_problems(problems), Effort(20, 5, np.inf, None)
    together, states, late = refine_parts(graph, decompose(graph), np.arange(len(key)), effort, key)
    assert not late
    restarts = 0
    offset = 0
    for problem in problems:
        alone, stats = refine(problem, seed=5, restarts=20)
        restarts += stats["restarts"]
        own = together[offset : offset + len(problem)]
        assert len({*zip(own.tolist(), alone.tolist(), strict=True)}) == len(set(alone.tolist()))
        assert len(set(own.tolist())) == len(set(alone.tolist()))
        assert np.isclose(stats["objective"], objective_of(problem, torch.from_numpy(alone)))
        assert is_distinct(torch.from_numpy(alone), problem.view)
        offset += len(problem)
    assert summary(states.sum(0))["restarts"] == restarts


@settings(max_examples=40, deadline=None)
@given(
    m=st.integers(0, 30),
    views=st.integers(1, 31),
    costs=st.sampled_from(["huge", "ties", "zero", "mixed", "attract"]),
    share=st.sampled_from([0.05, 0.3, 1.0]),
    dtype=st.sampled_from([torch.float32, torch.float64]),
    seed=st.integers(0, 10**6),
)
def test_any_problem_ends_feasible(
    m: int, views: int, costs: str, share: float, dtype: torch.dtype, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    view = torch.from_numpy(rng.permutation(31)[rng.integers(0, views, m)])
    pairs = torch.triu_indices(m, m, 1)
    pairs = pairs[:, view[pairs[0]] != view[pairs[1]]]
    pairs = pairs[:, torch.from_numpy(rng.random(pairs.shape[1])) < share]
    count = pairs.shape[1]
    value = {
        "huge": rng.choice([-1e6, 1e6, 1e-3, -1e-3], count),
        "ties": rng.choice([-1.0, 1.0], count),
        "zero": np.zeros(count),
        "mixed": rng.normal(size=count),
        "attract": np.full(count, -0.1),
    }[costs]
    cost = torch.from_numpy(value).to(dtype)
    problem = Problem(pairs, cost, view, (1 - cost) / 2)
    start = greedy(Graph.from_problem(problem))
    label, stats = refine(problem, start, restarts=5, seed=seed)
    again, _ = refine(problem, start, restarts=5, seed=seed)
    labels = torch.from_numpy(label)
    assert labels.shape == (m,)
    assert (label == again).all()
    assert is_distinct(labels, view)
    assert stats["objective"] <= stats["start"] <= 0
    scale = float(cost.abs().sum()) if count else 0.0
    assert abs(stats["objective"] - objective_of(problem, labels)) <= 1e-9 * scale


def test_stats_tell_what_each_kind_of_move_gained() -> None:
    graph = random_graph(2, 80, 1000)
    _, stats = refine(graph, greedy(graph), restarts=10)
    gained = stats["gained"]
    assert set(gained) == {"exhaustive", "descent", "annealing", "ruin_and_recreate"}
    assert min(gained.values()) >= 0
    assert np.isclose(sum(gained.values()), stats["start"] - stats["objective"], atol=1e-9)
    assert 0 < stats["restarts"] <= 10


def test_what_cannot_be_lower_is_left_at_once() -> None:
    pairs = np.stack(np.triu_indices(40, 1))
    cost = np.where(pairs[0] % 4 == pairs[1] % 4, -1.0, 1.0)
    graph = Graph.from_arrays(40, pairs, cost, np.zeros((2, 0), int))
    _, stats = refine(graph)
    assert stats["restarts"] == 0
    assert stats["objective"] == cost[cost < 0].sum()


@pytest.mark.parametrize("size", [1, 3, 50, 250, 800])
def test_large_parts_get_fewer_restarts_but_none_goes_without(size: int) -> None:
    assert restarts_of(size, 0) == 0
    assert 1 <= restarts_of(size, 1) <= restarts_of(size, 100) <= min(100, 2 * size)
    assert restarts_of(150, 100 * size) == 100 * size
