"""Padding changes nothing, and buckets hold everything once."""

import torch

from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.eigen import extreme_eigenvalues
from mixer_torch.solvers.gradient.batch import ENTRIES_CPU, Batch, buckets
from mixer_torch.solvers.gradient.graduated_non_convexity import graduated_descent
from mixer_torch.solvers.gradient.penalty_doubling import penalised_descent, spectral_start
from mixer_torch.solvers.gradient.relaxation import distinctness_matrix
from mixer_torch.solvers.problem import Problem, problem_of
from mixer_torch.solvers.search.decomposition import decompose
from mixer_torch.solvers.search.graph import Graph


def problems(sizes=(3, 5, 4), dtype=torch.float32):
    made = [synthetic(objects=4, views=n, seed=n, dtype=dtype)[0] for n in sizes]
    return [problem_of(affinity) for affinity in made]


def test_a_batch_holds_each_problem_and_zeros():
    some = problems()
    batch = Batch.of(some)
    for i, problem in enumerate(some):
        m = len(problem)
        assert torch.equal(batch.cost[i, :m, :m], problem.dense_cost())
        assert torch.equal(batch.distinctness[i, :m, :m], distinctness_matrix(problem.view))
        assert batch.mask[i].sum() == m
        assert not batch.cost[i, m:].any()
        assert not batch.distinctness[i, m:].any()


def test_sets_of_views_are_apart_where_they_meet():
    groups = torch.tensor([[0, 0, 1, 2, 2], [7, 8, 8, 9, 7]])
    empty = torch.zeros(0)
    pairs = torch.zeros(2, 0, dtype=torch.int64)
    problem = Problem(pairs, empty, torch.arange(3), empty, groups)
    expected = torch.tensor([[0.0, 1, 1], [1, 0, 0], [1, 0, 0]])
    assert torch.equal(Batch.of([problem]).distinctness[0], expected)


def test_a_batch_of_parts_is_what_the_graph_says():
    problem = problems((5,))[0]
    graph = Graph.from_problem(problem)
    parts = decompose(graph)
    chosen = list(range(len(parts)))
    batch = Batch.of_parts(graph, parts, chosen, problem.cost)
    for i in chosen:
        nodes = torch.from_numpy(parts.order[parts.start[i] : parts.start[i + 1]])
        m = len(nodes)
        assert torch.equal(batch.cost[i, :m, :m], problem.dense_cost()[nodes][:, nodes])
        assert torch.equal(
            batch.distinctness[i, :m, :m], problem.conflicts()[nodes][:, nodes].float()
        )
        assert batch.mask[i].sum() == m


def test_buckets_hold_each_index_once_and_alike():
    sizes = [3, 50, 51, 7, 400, 49, 12, 380, 1, *[30] * 500]
    found = list(buckets(sizes, torch.device("cpu")))
    assert sorted(i for bucket in found for i in bucket) == list(range(len(sizes)))
    for bucket in found:
        inside = [sizes[i] for i in bucket]
        assert min(inside) >= 0.75 * max(inside) - 8
        assert len(bucket) == 1 or len(bucket) * max(inside) ** 2 <= ENTRIES_CPU
    assert list(buckets([], torch.device("cpu"))) == []


def test_padding_does_not_change_a_descent():
    some = problems((3, 6), torch.float64)
    both = Batch.of(some)
    alone = Batch.of(some[:1])
    m, columns = len(some[0]), 6
    together = graduated_descent(both, columns).assignment[0]
    single = graduated_descent(alone, columns).assignment[0]
    torch.testing.assert_close(together[:m], single, atol=1e-6, rtol=0)
    assert not together[m:].any()


def test_the_objective_never_rises_while_d_stays():
    batch = Batch.of(problems((4,), torch.float64))
    start = spectral_start(batch, batch.cost.shape[1], seed=0)
    result = penalised_descent(batch, start, max_iterations=10)
    level = result.history[:, 0]
    assert bool((level[1:] <= level[:-1] + 1e-9).all())
    assert level[-1] < level[0]


def test_eigenvalues_of_large_matrices_are_nearly_right():
    generator = torch.Generator().manual_seed(0)
    matrix = torch.randn(2, 150, 150, generator=generator, dtype=torch.float64)
    matrix = matrix + matrix.mT
    low, high = extreme_eigenvalues(matrix)
    spectrum = torch.linalg.eigvalsh(matrix)
    width = spectrum[:, -1] - spectrum[:, 0]
    assert bool((low >= spectrum[:, 0] - 1e-9).all())
    assert bool(((low - spectrum[:, 0]) < 0.03 * width).all())
    assert bool(((spectrum[:, -1] - high) < 0.03 * width).all())
    zero = torch.zeros(1, 150, 150)
    assert [float(x) for x in extreme_eigenvalues(zero)] == [0.0, 0.0]
