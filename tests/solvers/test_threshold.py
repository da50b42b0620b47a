"""Links by threshold, worked by hand."""

import torch

import mixer_torch as mx
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.solvers.threshold import AllPairs, Consecutive

VIEW = torch.tensor([3, 3, 5, 8])  # three views in the order of time, with gaps in the numbers


def affinity(links):
    scores = torch.full((4, 4), 0.3)
    for a, b in links:
        scores[a, b] = scores[b, a] = 0.6
    return mx.Affinity.from_dense(scores, VIEW)


def test_links_above_half_are_kept_as_they_are():
    association = mx.solve(affinity([(0, 2), (2, 3)]), AllPairs())
    assert association.links.T.tolist() == [[0, 2], [2, 3]]
    assert association.labels is None
    assert association.status is mx.Status.INCONSISTENT
    assert evaluate(association, torch.tensor([0, 1, 0, 0]), VIEW)["open_cycles"] == 1


def test_transitive_links_are_clusters():
    association = mx.solve(affinity([(0, 2), (2, 3), (0, 3)]), AllPairs())
    assert association.labels.tolist() == [0, 1, 0, 0]
    assert association.status is mx.Status.CONVERGED


def test_links_that_join_one_view_are_not_consistent():
    association = mx.solve(affinity([(0, 2), (1, 2)]), AllPairs())
    assert association.status is mx.Status.INCONSISTENT


def test_exactly_half_says_nothing():
    half = mx.Affinity.from_dense(torch.full((4, 4), 0.5), VIEW)
    assert mx.solve(half, AllPairs()).links.shape == (2, 0)


def test_threshold_can_be_moved():
    links = [(0, 2), (0, 3), (2, 3)]
    assert mx.solve(affinity(links), AllPairs(threshold=0.7)).links.shape == (2, 0)


def test_consecutive_looks_at_the_next_view_only():
    association = mx.solve(affinity([(0, 2), (2, 3), (0, 3)]), Consecutive())
    assert association.links.T.tolist() == [[0, 2], [2, 3]]  # views 3, 5 and 8 follow each other
    assert association.labels is None
