"""Association: links from labels, the gap, and files."""

import itertools

import pytest
import torch

import mixer_torch as mx
from mixer_torch.association import by_first_appearance, links_of


def test_links_are_all_pairs_of_a_label():
    generator = torch.Generator().manual_seed(0)
    for m in range(9):
        labels = torch.randint(0, 4, (m,), generator=generator)
        expected = [
            [a, b] for a, b in itertools.combinations(range(m), 2) if labels[a] == labels[b]
        ]
        assert links_of(labels).T.tolist() == expected


def test_labels_are_numbered_as_they_appear():
    assert by_first_appearance(torch.tensor([7, -2, 7, 5, -2])).tolist() == [0, 1, 0, 2, 1]
    assert by_first_appearance(torch.zeros(0, dtype=torch.int64)).tolist() == []


@pytest.mark.parametrize(
    ("objective", "bound", "gap"),
    [
        (-10.0, -11.0, 0.1),
        (-10.0, -10.0, 0.0),
        (-10.0, -9.0, 0.0),
        (-10.0, None, None),
        (0.0, 0.0, 0.0),
    ],
)
def test_gap(objective, bound, gap):
    labels = torch.tensor([0, 0])
    answer = mx.Association(labels, objective, mx.Status.CONVERGED, bound)
    assert answer.gap == (None if gap is None else pytest.approx(gap))


def test_links_that_are_not_consistent_have_no_gap():
    links = torch.tensor([[0, 0], [1, 2]])
    answer = mx.Association(None, -2.0, mx.Status.INCONSISTENT, -1.0, declared_links=links)
    assert answer.gap is None


def test_labels_or_links_and_not_both():
    labels, links = torch.tensor([0, 1]), torch.zeros(2, 0, dtype=torch.int64)
    for wrong in ((labels, links), (None, None)):
        with pytest.raises(ValueError, match="labels, declared_links: expected one of them"):
            mx.Association(wrong[0], 0.0, mx.Status.OPTIMAL, declared_links=wrong[1])
    assert mx.Association(labels, 0.0, mx.Status.OPTIMAL).num_clusters == 2
    assert (
        mx.Association(None, 0.0, mx.Status.INCONSISTENT, declared_links=links).num_clusters is None
    )


@pytest.mark.parametrize("bound", [None, -3.5])
def test_saved_and_loaded_is_the_same(tmp_path, bound):
    labels = torch.tensor([0, 1, 0])
    answer = mx.Association(labels, -2.5, mx.Status.TIME_LIMIT, bound, {"iterations": 4})
    answer.save(tmp_path / "a.npz")
    loaded = mx.Association.load(tmp_path / "a.npz")
    assert loaded.links.tolist() == [[0], [2]]
    assert (loaded.objective, loaded.lower_bound) == (-2.5, bound)
    assert (loaded.status, dict(loaded.stats)) == (mx.Status.TIME_LIMIT, {"iterations": 4})


def test_links_without_labels_are_saved(tmp_path):
    links = torch.tensor([[0, 1], [1, 2]])
    answer = mx.Association(None, 1.0, mx.Status.INCONSISTENT, declared_links=links)
    answer.save(tmp_path / "a.npz")
    loaded = mx.Association.load(tmp_path / "a.npz")
    assert loaded.labels is None
    assert torch.equal(loaded.links, links)


def test_every_status_says_what_happened():
    assert all(len(status.value) > 10 for status in mx.Status)
    assert "raise time_limit" in mx.Status.TIME_LIMIT.value


def test_repr_is_one_short_line():
    found = mx.Association(torch.tensor([0, 0, 1]), -1.5, mx.Status.OPTIMAL, -1.5)
    assert repr(found) == (
        "Association(3 observations in 2 clusters; objective -1.5, lower bound -1.5; OPTIMAL; cpu)"
    )
    links = torch.tensor([[0, 1], [1, 2]])
    loose = mx.Association(None, 2.0, mx.Status.INCONSISTENT, declared_links=links)
    assert repr(loose) == "Association(2 links, no labels; objective 2; INCONSISTENT; cpu)"
