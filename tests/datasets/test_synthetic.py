"""Synthetic problems: the model's frequencies, and what holds for every draw."""

import pytest
import torch

from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.pairs import within_view


def truth(affinity, labels):
    return labels[affinity.pairs[0]] == labels[affinity.pairs[1]]


def test_without_noise_the_scores_are_the_truth():
    affinity, labels = synthetic(modalities=2, wrong=0.0, noise=0.0)
    assert (affinity.scores == truth(affinity, labels)).all()
    assert affinity.modalities == ("score_0", "score_1")


@pytest.mark.parametrize("seed", range(5))
def test_labels(seed):
    affinity, labels = synthetic(objects=5, views=7, visible=0.3, outliers=1.0, seed=seed)
    first = [int((labels == k).nonzero()[0]) for k in range(int(labels.max()) + 1)]
    assert first == sorted(first)
    assert affinity.view.unique().tolist() == list(range(7))
    named = torch.stack([affinity.view, labels])
    assert torch.unique(named, dim=1).shape == named.shape
    m = len(affinity)
    every = torch.triu_indices(m, m, offset=1)
    assert torch.equal(affinity.pairs, every[:, ~within_view(affinity.view, every)])


def test_size_of_the_paper():
    for seed in range(20):
        affinity, _ = synthetic(seed=seed)
        assert 10 <= len(affinity) <= 70


def test_frequencies():
    affinity, labels = synthetic(
        objects=40, views=20, visible=0.7, outliers=2.0, modalities=2,
        wrong=(0.1, 0.3), inconclusive=(0.0, 0.5), noise=(0.0, 0.0),
    )  # fmt: skip
    same = truth(affinity, labels)
    counts = torch.bincount(labels)
    seen = int(counts[counts > 1].sum())
    assert seen / (40 * 20) == pytest.approx(0.7, abs=0.05)
    assert (len(affinity) - seen) / 20 == pytest.approx(2, abs=1)
    first, second = affinity.scores
    assert (first != same).float().mean() == pytest.approx(0.1, abs=0.01)
    assert (second == 0.5).float().mean() == pytest.approx(0.5, abs=0.01)
    said = second != 0.5
    assert (second != same)[said].float().mean() == pytest.approx(0.3, abs=0.01)


def test_noise_has_the_deviation_asked_for():
    affinity, labels = synthetic(objects=40, views=10, wrong=0.0, noise=0.1)
    away = (affinity.scores[0] - truth(affinity, labels).float()).abs()
    # Half the draws are clipped at the truth; the mean of |N(0, 0.1)| / 2 is 0.0399.
    assert away.mean() == pytest.approx(0.0399, abs=0.001)
    assert (away == 0).float().mean() == pytest.approx(0.5, abs=0.01)


def test_every_view_shows_something():
    affinity, _ = synthetic(objects=3, views=50, visible=0.0, outliers=0.0)
    assert affinity.view.tolist() == list(range(50))


def test_draws_depend_on_the_seed_alone():
    state = torch.get_rng_state()
    (a, labels_a), (b, labels_b) = synthetic(seed=3), synthetic(seed=3)
    assert torch.equal(a.scores, b.scores)
    assert torch.equal(labels_a, labels_b)
    generator = torch.Generator().manual_seed(3)
    assert torch.equal(synthetic(seed=generator)[0].scores, a.scores)
    following = synthetic(seed=generator)[0]
    assert len(following) != len(a) or not torch.equal(following.scores, a.scores)
    assert torch.equal(torch.get_rng_state(), state)


def test_dtype_gives_the_same_problem():
    single, double = (synthetic(dtype=dtype)[0] for dtype in (torch.float32, torch.float64))
    assert double.scores.dtype == torch.float64
    assert torch.equal(double.scores.float(), single.scores)


@pytest.mark.cuda
def test_device_gives_the_same_problem():
    (host, host_labels), (device, labels) = synthetic(), synthetic(device="cuda")
    assert device.scores.device.type == labels.device.type == "cuda"
    assert torch.equal(host.scores, device.scores.cpu())
    assert torch.equal(host_labels, labels.cpu())


@pytest.mark.parametrize(("objects", "views"), [(0, 3), (3, 0), (0, 0), (1, 1)])
def test_degenerate(objects, views):
    affinity, labels = synthetic(objects=objects, views=views, outliers=0.0)
    m = 1 if objects and views else 0
    assert labels.tolist() == [0] * m
    assert affinity.scores.shape == (1, 0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"objects": -1}, "objects"),
        ({"views": -1}, "views"),
        ({"modalities": 0}, "modalities"),
        ({"visible": 1.5}, "visible"),
        ({"outliers": -0.5}, "outliers"),
        ({"wrong": 1.1}, "wrong"),
        ({"noise": float("nan")}, "noise"),
        ({"modalities": 2, "inconclusive": [0.1]}, "inconclusive: expected 2 values, got 1"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        synthetic(**arguments)
