"""Chained linear assignment, worked by hand."""

import torch

import mixer_torch as mx
from mixer_torch.solvers.hungarian import Hungarian


def test_the_sum_decides_and_not_the_single_best():
    # 0.9 + 0.5 would take the best pair first; 0.8 + 0.8 is more.
    view = torch.tensor([0, 0, 1, 1])
    pairs = torch.tensor([[0, 0, 1, 1], [2, 3, 2, 3]])
    scores = torch.tensor([[0.9, 0.8, 0.8, 0.5]])
    association = mx.solve(mx.Affinity(pairs, scores, view, ("one",)), Hungarian())
    assert association.labels.tolist() == [0, 1, 1, 0]


def test_a_missed_object_starts_a_new_track():
    view = torch.tensor([0, 1, 1, 2])
    identity = torch.tensor([0, 0, 1, 0])
    scores = (identity[:, None] == identity).float()
    association = mx.solve(mx.Affinity.from_dense(scores, view), Hungarian())
    assert association.labels.tolist() == [0, 0, 1, 0]
    gap = torch.tensor([0, 1, 2])  # the middle view sees another object
    scores = torch.tensor([[1.0, 0, 1], [0, 1, 0], [1, 0, 1]])
    association = mx.solve(mx.Affinity.from_dense(scores, gap), Hungarian())
    assert association.labels.tolist() == [0, 1, 2]


def test_matches_have_to_beat_the_threshold():
    scores = torch.tensor([[1.0, 0.6], [0.6, 1.0]])
    affinity = mx.Affinity.from_dense(scores, [0, 1])
    assert mx.solve(affinity, Hungarian()).num_clusters == 1
    assert mx.solve(affinity, Hungarian(threshold=0.7)).num_clusters == 2
