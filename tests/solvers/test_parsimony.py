import pytest
import torch

import mixer_torch as mx
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.parsimony import without_idle_links
from mixer_torch.solvers.problem import is_distinct, objective_of, problem_of
from mixer_torch.solvers.search.graph import Graph


def two_groups_with_nothing_between():
    """0 ~ 1 and 2 ~ 3, each in two views of its own; no pair between them is listed."""
    pairs = torch.tensor([[0, 2], [1, 3]])
    return mx.Affinity(pairs, torch.tensor([[0.9, 0.8]]), torch.arange(4), ("score",))


@pytest.mark.parametrize("solver", [mx.Mixer(), mx.Mixer(seed=1), mx.Exact()])
def test_groups_with_nothing_between_them_stay_apart(solver):
    affinity = two_groups_with_nothing_between()
    assert mx.solve(affinity, solver).labels.tolist() == [0, 0, 1, 1]
    silent = torch.full((1, 4), 0.5)
    pairs = torch.tensor([[0, 0, 0, 0, 1, 2], [1, 2, 3, 4, 4, 3]])
    scores = torch.cat([torch.tensor([[0.9]]), silent, torch.tensor([[0.8]])], 1)
    listed = mx.Affinity(pairs, scores, torch.arange(5), ("score",))
    assert mx.solve(listed, solver).labels.tolist() == [0, 0, 1, 1, 2]


@pytest.mark.parametrize("seed", range(10))
def test_never_dearer_and_held_together_by_evidence(seed):
    problem = problem_of(synthetic(5, 4, inconclusive=0.6, seed=seed)[0])
    generator = torch.Generator().manual_seed(seed)
    labels = torch.randint(3, (len(problem),), generator=generator)
    split = torch.from_numpy(without_idle_links(Graph.from_problem(problem), labels.numpy()))
    assert objective_of(problem, split) <= objective_of(problem, labels) + 1e-6
    for part in split.unique():
        members = (split == part).nonzero()[:, 0]
        assert len(labels[members].unique()) == 1
        reached, grown = members[:1], members[:0]
        while len(grown) < len(reached):
            grown = reached
            a, b = problem.pairs[:, problem.cost < 0]
            near = torch.cat([b[torch.isin(a, grown)], a[torch.isin(b, grown)], grown]).unique()
            reached = near[torch.isin(near, members)]
        assert reached.tolist() == members.tolist()


def test_an_optimum_stays_one():
    problem = problem_of(synthetic(6, 4, seed=3)[0])
    best = mx.solve(synthetic(6, 4, seed=3)[0], mx.Exact())
    split = without_idle_links(Graph.from_problem(problem), best.labels.numpy())
    split = torch.from_numpy(split)
    assert objective_of(problem, split) == pytest.approx(best.objective)
    assert is_distinct(split, problem.view)
