"""solve(): what is checked, what is told, and what a faulty solver leads to."""

import pytest
import torch

import mixer_torch as mx
from mixer_torch.solvers.problem import Problem, Solution, Solver, is_distinct, objective_of

NONE, FOUR = torch.zeros(0, dtype=torch.int64), torch.tensor([4])
VIEW = torch.tensor([0, 0, 1, 1])
SCORES = torch.tensor([[1, 0, 0.9, 0.2], [0, 1, 0.3, 0.7], [0.9, 0.3, 1, 0], [0.2, 0.7, 0, 1]])


class Says(Solver):
    """A solver that returns what it was told to."""

    takes_groups = True

    def __init__(self, **answer):
        self.answer = answer

    def run(self, problem):
        return Solution(mx.Status.CONVERGED, **self.answer)


@pytest.fixture
def affinity():
    return mx.Affinity.from_dense(SCORES, VIEW)


def test_objective_is_the_cost_of_the_links(affinity):
    answer = mx.solve(affinity, Says(labels=torch.tensor([9, 4, 9, 4])))
    assert answer.labels.tolist() == [0, 1, 0, 1]
    assert answer.objective == pytest.approx((1 - 1.8) + (1 - 1.4))
    assert answer.links.tolist() == [[0, 1], [2, 3]]
    linked = mx.solve(affinity, Says(links=torch.tensor([[0, 0], [2, 3]])))
    assert linked.labels is None
    assert linked.objective == pytest.approx((1 - 1.8) + (1 - 0.4))


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ({"labels": torch.tensor([0, 0, 1, 2])}, "two observations of one view"),
        ({"labels": torch.tensor([0, 1])}, "2 labels for 4"),
        ({}, "neither labels nor links"),
    ],
)
def test_a_faulty_solver_is_told(affinity, answer, message):
    with pytest.raises(RuntimeError, match=message):
        mx.solve(affinity, Says(**answer))


def test_a_solver_that_breaks_a_link_is_told(affinity):
    alone = Says(labels=torch.arange(4))
    assert mx.solve(affinity, alone, cannot_link=[[0], [2]]).num_clusters == 4
    with pytest.raises(RuntimeError, match=r"broke cannot_link \(0, 2\)"):
        mx.solve(affinity, Says(labels=torch.tensor([0, 1, 0, 2])), cannot_link=[[0], [2]])


def test_no_observations_and_one():
    empty = mx.Affinity(torch.zeros(2, 0, dtype=torch.int64), torch.zeros(1, 0), NONE, ("a",))
    answer = mx.solve(empty, mx.Exact(), bound=True)
    assert answer.labels.tolist() == []
    assert (answer.objective, answer.lower_bound, answer.status) == (0, 0, mx.Status.OPTIMAL)
    one = mx.Affinity(torch.zeros(2, 0, dtype=torch.int64), torch.zeros(1, 0), FOUR, ("a",))
    for solver in (mx.Exact(), mx.Mixer()):
        answer = mx.solve(one, solver, bound=True)
        assert (answer.labels.tolist(), answer.objective, answer.gap) == ([0], 0, 0)
    assert mx.solve([]) == []
    assert [len(a.labels) for a in mx.solve([empty, one])] == [0, 1]


def test_a_bound_is_proven_where_it_is_wanted(affinity):
    said = Says(labels=torch.arange(4))
    assert mx.solve(affinity, said).lower_bound is None
    assert mx.solve(affinity, said, bound=True).lower_bound == pytest.approx(-1.2, abs=1e-3)
    knows = Says(labels=torch.arange(4), lower_bound=-5.0)
    assert mx.solve(affinity, knows, bound=True).lower_bound == -5


def test_groups_say_who_may_not_be_together():
    pairs, cost = torch.tensor([[0, 0], [1, 2]]), torch.tensor([-1.0, 2.0])
    groups = torch.tensor([[0, 0, 1, 2, 2], [3, 8, 8, 3, 5]])
    problem = Problem(pairs, cost, torch.arange(3), torch.full((2,), 0.5), groups)
    assert sorted(problem.conflicts().nonzero().tolist()) == [[0, 1], [0, 2], [1, 0], [2, 0]]
    simple = problem.simplified()
    assert simple.groups.tolist() == [[0, 0, 1, 2], [0, 2, 2, 0]]
    one_each = Problem(pairs, cost, torch.arange(3), torch.full((2,), 0.5), groups[:, 1:3])
    plain = one_each.simplified()
    assert plain.groups is None
    assert plain.view[0] == plain.view[1] != plain.view[2]
    assert torch.equal(plain.conflicts(), one_each.conflicts())
    assert plain.incidence.tolist()[0] == [0, 1, 2]


def test_distinctness_and_objective_by_hand(affinity):
    assert is_distinct(torch.tensor([0, 1, 1, 0]), VIEW)
    assert not is_distinct(torch.tensor([0, 1, 2, 2]), VIEW)
    problem = Problem(torch.tensor([[0], [2]]), torch.tensor([-2.5]), VIEW, torch.tensor([0.5]))
    assert objective_of(problem, torch.tensor([0, 1, 0, 2])) == -2.5
    assert problem.dense_cost()[2, 0] == -2.5
