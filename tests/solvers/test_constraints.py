"""Must-link, cannot-link and waived distinctness: against enumeration; contradictions."""

import numpy as np
import pytest
import torch
from enumeration import optimum
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import mixer_torch as mx
from mixer_torch.solvers.constraints import constrain
from mixer_torch.solvers.problem import Problem, Solution, Solver, problem_of


class Alone(Solver):
    """Every node a cluster: the least that a solver can do."""

    def run(self, problem):
        return Solution(mx.Status.CONVERGED, labels=torch.arange(len(problem)))


class AloneWithTokens(Alone):
    takes_groups = True


class Linked(Solver):
    """Links of all nodes that may be together, consistent or not."""

    takes_groups = True

    def run(self, problem):
        return Solution(mx.Status.INCONSISTENT, links=problem.pairs)


def affinity_of(rng, view, indistinct=None):
    m = len(view)
    scores = rng.random((m, m))
    return mx.Affinity.from_dense((scores + scores.T) / 2, view, indistinct=indistinct)


def dense(affinity):
    cost = problem_of(affinity).dense_cost().double().numpy()
    view = affinity.view.numpy()
    return cost, (view[:, None] == view) & (view >= 0)[:, None] & ~np.eye(len(view), dtype=bool)


@pytest.mark.parametrize("solver", [mx.Exact(), mx.Mixer()], ids=["Exact", "Mixer"])
def test_the_optimum_under_constraints_is_found(solver):
    rng = np.random.default_rng(0)
    solved = exact = 0
    while solved < 40:
        m = int(rng.integers(4, 8))
        affinity = affinity_of(rng, rng.integers(0, 4, m))
        must, cannot = (rng.choice(m, (2, 2), replace=False) for _ in range(2))
        cost, forbidden = dense(affinity)
        for a, b in cannot.T:
            forbidden[a, b] = forbidden[b, a] = True
        best = optimum(cost, forbidden, must.T)
        if np.isinf(best):
            with pytest.raises(ValueError, match="must_link"):
                mx.solve(affinity, solver, must_link=must, cannot_link=cannot)
            continue
        answer = mx.solve(affinity, solver, must_link=must, cannot_link=cannot, bound=True)
        labels = answer.labels
        assert (labels[must[0]] == labels[must[1]]).all()
        assert (labels[cannot[0]] != labels[cannot[1]]).all()
        assert answer.objective >= best - 1e-6
        assert answer.lower_bound <= best + 1e-6
        exact += answer.objective < best + 1e-6
        solved += 1
    assert exact == 40 if isinstance(solver, mx.Exact) else exact >= 38


def test_cost_inside_groups_counts_and_links_are_told_for_observations():
    view = [0, 0, 1, 1, 2]
    affinity = affinity_of(np.random.default_rng(1), view)
    cost, _ = dense(affinity)
    answer = mx.solve(affinity, AloneWithTokens(), must_link=[[0, 2], [2, 4]])
    assert answer.labels.tolist() == [0, 1, 0, 2, 0]
    assert answer.objective == pytest.approx(cost[0, 2] + cost[0, 4] + cost[2, 4])
    links = mx.solve(affinity, Linked(), must_link=[[0, 2], [2, 4]]).links
    assert sorted(links.T.tolist()) == [[0, 2], [0, 4], [1, 3], [2, 4]]


def test_no_constraint_leaves_the_problem_as_it_is():
    affinity = affinity_of(np.random.default_rng(2), [0, 0, 1, 2])
    problem = problem_of(affinity)
    _, reduction = constrain(problem, affinity.view, must_link=[], cannot_link=None)
    assert reduction.problem is problem


def test_a_cannot_link_is_a_view_that_two_share():
    affinity = affinity_of(np.random.default_rng(3), [0, 0, 1, 2])
    _, reduction = constrain(problem_of(affinity), affinity.view, cannot_link=[[0], [2]])
    apart = reduction.problem.conflicts()
    assert sorted(apart.nonzero().tolist()) == [[0, 1], [0, 2], [1, 0], [2, 0]]
    assert not reduction.problem.dense_cost()[apart].any()


def test_indistinct_views_are_none():
    rng = np.random.default_rng(4)
    scores = rng.random((6, 6))
    scores = (scores + scores.T) / 2
    view = np.array([5, 5, 5, 2, 2, 3])
    listed = mx.Affinity.from_dense(scores, view, indistinct=[5])
    assert listed.view.tolist() == [-1, -1, -1, 2, 2, 3]
    cost, forbidden = dense(listed)
    answer = mx.solve(listed, mx.Exact())
    assert answer.objective == pytest.approx(optimum(cost, forbidden), abs=1e-6)

    unlisted = mx.Affinity.from_dense(scores, view)
    cost, forbidden = dense(unlisted)
    forbidden[:3, :3] = False
    answer = mx.solve(unlisted, mx.Exact(), indistinct=[5])
    assert answer.objective == pytest.approx(optimum(cost, forbidden), abs=1e-6)
    linked = mx.solve(unlisted, mx.Exact(), indistinct=[5], must_link=[[0, 1], [1, 2]])
    assert len(set(linked.labels[:3].tolist())) == 1


def test_contradictions_name_the_pairs():
    affinity = affinity_of(np.random.default_rng(5), [7, 7, 1, 2, 3])
    chain = r"must_link: \(0, 2\), \(2, 1\) joins 0 and 1, which are both of view 7"
    with pytest.raises(ValueError, match=chain):
        mx.solve(affinity, must_link=[[0, 2], [2, 1]])
    with pytest.raises(ValueError, match=r"cannot_link: \(0, 3\) contradicts .*\(0, 2\), \(2, 3\)"):
        mx.solve(affinity, must_link=[[0, 2], [2, 3]], cannot_link=[[0], [3]])


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ({"must_link": [0, 1]}, "must_link: expected integers of shape"),
        ({"cannot_link": [[0.5], [1.0]]}, "cannot_link: expected integers of shape"),
        ({"must_link": [[0], [5]]}, r"must_link: expected pairs .* in 0..4, got \(0, 5\)"),
        ({"must_link": [[3], [3]]}, r"must_link: expected pairs .*, got \(3, 3\)"),
        ({"indistinct": [9]}, "indistinct: no observation is of view 9"),
    ],
)
def test_malformed_arguments_are_named(argument, message):
    affinity = affinity_of(np.random.default_rng(6), [7, 7, 1, 2, 3])
    with pytest.raises(ValueError, match=message):
        mx.solve(affinity, **argument)


def test_a_solver_without_sets_of_views_is_given_what_it_can_honour_or_refused():
    affinity = affinity_of(np.random.default_rng(7), [0, 0, 1, 1, -1])
    answer = mx.solve(affinity, Alone(), must_link=[[0], [4]])
    assert answer.labels.tolist() == [0, 1, 2, 3, 0]
    with pytest.raises(ValueError, match="solver: Alone cannot honour"):
        mx.solve(affinity, Alone(), must_link=[[0], [2]])


def test_each_problem_of_a_list_has_its_own():
    rng = np.random.default_rng(8)
    both = [affinity_of(rng, [0, 0, 1, 1]) for _ in range(2)]
    answers = mx.solve(both, must_link=[[[0], [2]], None], cannot_link=[None, [[0], [2]]])
    assert answers[0].labels[0] == answers[0].labels[2]
    assert answers[1].labels[0] != answers[1].labels[2]
    with pytest.raises(ValueError, match="must_link: expected None or a list with an entry for"):
        mx.solve(both, must_link=torch.zeros(2, 0, dtype=torch.int64))


def test_a_batch_of_random_problems_with_random_constraints_is_honoured():
    rng = np.random.default_rng(9)
    affinities = [affinity_of(rng, rng.integers(0, 6, 15)) for _ in range(5)]
    cannot = [rng.choice(15, (2, 3), replace=False) for _ in affinities]
    for answer, pairs in zip(mx.solve(affinities, cannot_link=cannot), cannot, strict=True):
        assert (answer.labels[pairs[0]] != answer.labels[pairs[1]]).all()


def test_pairs_of_groups_with_a_view_in_common_are_dropped_and_no_others():
    rng = np.random.default_rng(10)
    for _ in range(30):
        m = int(rng.integers(6, 12))
        view = rng.integers(-1, 4, m)
        affinity = affinity_of(rng, view)
        ends = rng.permutation(m)[:4].reshape(2, 2)
        cannot = rng.choice(m, (2, 2), replace=False)
        try:
            _, reduction = constrain(problem_of(affinity), affinity.view, ends, cannot)
        except ValueError:
            continue
        has = [set() for _ in range(len(reduction.problem))]
        for i, group in enumerate(reduction.node.tolist()):
            own = {("view", int(view[i]))} if view[i] >= 0 else set()
            has[group] |= own | {("pair", k) for k in range(2) if i in cannot[:, k]}
        ends = reduction.node[affinity.pairs]
        low, high = ends.min(0).values.tolist(), ends.max(0).values.tolist()
        free = {(a, b) for a, b in zip(low, high, strict=True) if a != b and not has[a] & has[b]}
        assert free == {(int(a), int(b)) for a, b in reduction.problem.pairs.T}


def test_large_views_cost_no_more_than_small_ones():
    """A matrix of which nodes share a view would have 200 million entries."""
    m = 20_000
    first = torch.arange(m // 2)
    pairs = torch.stack([first, m // 2 + first])
    view = (torch.arange(m) >= m // 2).long()
    problem = Problem(pairs, torch.rand(m // 2), view, torch.full((m // 2,), 0.5))
    sizes = []

    class Watch(TorchDispatchMode):
        def __torch_dispatch__(self, operation, types, args=(), kwargs=None):
            result = operation(*args, **(kwargs or {}))
            sizes.extend(x.numel() for x in tree_leaves(result) if isinstance(x, torch.Tensor))
            return result

    with Watch():
        _, reduction = constrain(problem, view, must_link=[[0], [m - 1]])
    assert max(sizes) <= 10 * m
    assert reduction.problem.pairs.shape[1] == m // 2 - 2


def test_views_may_be_any_numbers():
    """Such as times in nanoseconds, or the largest there are."""
    view = np.array([2**62 - 1, 2**62 - 1, 5, 5, 2**63 - 1, 2**63 - 1])
    affinity = affinity_of(np.random.default_rng(11), view)
    answer = mx.solve(affinity, must_link=[[0, 1], [2, 4]])
    assert answer.labels[0] == answer.labels[2] != answer.labels[1]
    with pytest.raises(ValueError, match="which are both of view 9223372036854775807"):
        mx.solve(affinity, must_link=[[4, 0], [0, 5]])
