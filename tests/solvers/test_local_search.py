"""Local search alone: optimal on what is small, and no worse than greedy contraction."""

import pytest
import torch

from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.base import solve
from mixer_torch.solvers.exact import Exact
from mixer_torch.solvers.local_search import LocalSearch
from mixer_torch.solvers.problem import problem_of
from mixer_torch.solvers.search.graph import Graph
from mixer_torch.solvers.search.greedy import greedy


@pytest.mark.parametrize("seed", range(10))
def test_reaches_the_optimum_of_small_problems(seed):
    affinity, _ = synthetic(objects=3, views=4, noise=0.3, seed=seed)
    best = solve(affinity, Exact()).objective
    assert solve(affinity, LocalSearch()).objective == pytest.approx(best, abs=1e-6)


def test_is_no_worse_than_greedy_contraction_and_better_somewhere():
    gains = []
    for seed in range(10):
        affinity, _ = synthetic(objects=8, views=8, noise=0.5, wrong=0.2, seed=seed)
        graph = Graph.from_problem(problem_of(affinity))
        start = graph.objective(greedy(graph))
        gains.append(start - solve(affinity, LocalSearch()).objective)
    assert min(gains) > -1e-6
    assert max(gains) > 0.1


def test_links_are_kept():
    affinity, labels = synthetic(objects=4, views=5, seed=1)
    a = int((labels == 0).nonzero()[0])
    b = int(((affinity.view != affinity.view[a]) & (labels == 1)).nonzero()[0])
    joined = solve(affinity, LocalSearch(), must_link=torch.tensor([[a], [b]])).labels
    assert joined[a] == joined[b]


def test_seed():
    affinity, _ = synthetic(objects=8, views=8, noise=0.6, wrong=0.3, seed=5)
    first, second = (solve(affinity, LocalSearch(seed=3)).labels for _ in range(2))
    assert torch.equal(first, second)


@pytest.mark.parametrize(
    ("arguments", "message"), [({"restarts": -1}, "restarts"), ({"time_limit": 0.0}, "time_limit")]
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        LocalSearch(**arguments)
