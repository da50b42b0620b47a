import itertools

import pytest
import torch
from sklearn.metrics import adjusted_rand_score

from mixer_torch.association import Association, Status, links_of
from mixer_torch.metrics.clustering import (
    adjusted_rand,
    bcubed,
    consistency,
    evaluate,
    pairwise,
    pairwise_of_links,
    singletons_for_clutter,
)


def random_case(seed, m=40):
    generator = torch.Generator().manual_seed(seed)

    def draw(low, high):
        return torch.randint(low, high, (m,), generator=generator)

    return draw(0, 9), draw(-1, 7), draw(-1, 6)


def counted_by_hand(labels, identity, view):
    correct = declared = true = 0
    for a, b in itertools.combinations(range(len(labels)), 2):
        if view[a] == view[b] and view[a] >= 0:
            continue
        same = bool(identity[a] == identity[b] and identity[a] >= 0)
        together = bool(labels[a] == labels[b])
        correct, declared, true = correct + (same and together), declared + together, true + same
    return correct, declared, true


@pytest.mark.parametrize("seed", range(5))
def test_pairwise_counts_pairs_across_views(seed):
    labels, identity, view = random_case(seed)
    correct, declared, true = counted_by_hand(labels, identity, view)
    metrics = pairwise(labels, identity, view)
    assert metrics["precision"] == pytest.approx(correct / declared)
    assert metrics["recall"] == pytest.approx(correct / true)
    assert (metrics["declared_pairs"], metrics["true_pairs"]) == (declared, true)
    assert pairwise_of_links(links_of(labels), identity, view) == pytest.approx(metrics)


@pytest.mark.parametrize("seed", range(5))
def test_adjusted_rand_agrees_with_scikit_learn(seed):
    labels, identity, _ = random_case(seed)
    truth = singletons_for_clutter(identity)
    expected = adjusted_rand_score(truth.numpy(), labels.numpy())
    assert adjusted_rand(labels, truth) == pytest.approx(expected)


def test_bcubed_of_a_case_worked_by_hand():
    # Clusters {a a b} and {b}: precision (2/3 + 2/3 + 1/3 + 1) / 4, recall (1 + 1 + 1/2 + 1/2) / 4.
    metrics = bcubed(torch.tensor([0, 0, 0, 1]), torch.tensor([5, 5, 7, 7]))
    assert metrics["bcubed_precision"] == pytest.approx((2 / 3 + 2 / 3 + 1 / 3 + 1) / 4)
    assert metrics["bcubed_recall"] == pytest.approx(3 / 4)


def test_links_to_clutter_are_wrong():
    metrics = pairwise(
        torch.zeros(3, dtype=torch.int64), torch.tensor([-1, -1, 4]), torch.arange(3)
    )
    assert (metrics["precision"], metrics["recall"]) == (0.0, 1.0)


def test_consistency_counts_what_breaks():
    # 0-1-2 is an open path, 3-4-5 a closed triangle, and 0-1 lie in one view.
    links = torch.tensor([[0, 1, 3, 3, 4], [1, 2, 4, 5, 5]])
    found = consistency(links, torch.tensor([0, 0, 1, 0, 1, 2]))
    assert found == {"within_view_links": 1, "open_cycles": 1}


@pytest.mark.parametrize("m", [0, 1])
def test_nothing_to_associate_is_perfect(m):
    labels, view = torch.zeros(m, dtype=torch.int64), torch.zeros(m, dtype=torch.int64)
    metrics = evaluate(Association(labels, 0.0, Status.OPTIMAL), labels, view)
    assert metrics["f1"] == metrics["bcubed_f1"] == metrics["adjusted_rand"] == 1.0
    assert metrics["clusters"] == metrics["objects"] == m


def test_links_without_labels_are_evaluated():
    links = torch.tensor([[0, 1], [1, 2]])
    association = Association(None, 0.0, Status.INCONSISTENT, declared_links=links)
    metrics = evaluate(association, torch.tensor([1, 1, 2]), torch.arange(3))
    assert metrics["precision"] == 0.5
    assert metrics["open_cycles"] == 1


def test_lengths_must_agree():
    association = Association(torch.tensor([0]), 0.0, Status.OPTIMAL)
    with pytest.raises(ValueError, match="identity, view, labels"):
        evaluate(association, torch.tensor([0, 1]), torch.tensor([0]))
