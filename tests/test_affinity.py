"""Affinity: forms, files, and every way in which it can be malformed."""

import numpy as np
import pytest
import torch

import mixer_torch as mx

VIEW = torch.tensor([3, 3, 0, -1, -1])


def matrix(seed=0, l=2, m=5):
    scores = np.random.default_rng(seed).random((l, m, m))
    return (scores + scores.transpose(0, 2, 1)) / 2


@pytest.mark.parametrize("form", [torch.as_tensor, np.asarray])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_dense_and_back(form, dtype):
    scores = matrix().astype(dtype)
    affinity = mx.Affinity.from_dense(form(scores), VIEW, ("a", "b"))
    assert affinity.scores.dtype == getattr(torch, dtype)
    assert affinity.pairs.shape == (2, 9)  # of 10, one is within view 3
    expected = scores.copy()
    expected[:, 0, 1] = expected[:, 1, 0] = 0
    expected[:, range(5), range(5)] = 1
    assert np.array_equal(affinity.dense().numpy(), expected)


def test_what_is_not_listed_has_nothing_to_say():
    affinity = mx.Affinity(torch.tensor([[0], [2]]), torch.tensor([[0.8]]), VIEW, ("a",))
    dense = affinity.dense()[0]
    assert dense[0, 2] == dense[2, 0] == pytest.approx(0.8)
    assert (dense[0, 3], dense[0, 1], dense[4, 4]) == (0.5, 0, 1)
    assert len(affinity) == 5


def test_a_single_matrix_gets_a_name_and_within_view_entries_are_ignored():
    scores = matrix(l=1)[0]
    scores[0, 1] = np.nan
    affinity = mx.Affinity.from_dense(scores, VIEW)
    assert affinity.modalities == ("score_0",)
    assert bool(affinity.scores.isfinite().all())


def test_select_keeps_the_order_asked_for():
    affinity = mx.Affinity.from_dense(matrix(), VIEW, ("a", "b"))
    swapped = affinity.select(("b", "a"))
    assert torch.equal(swapped.scores, affinity.scores.flip(0))
    assert affinity.select("b").modalities == ("b",)
    with pytest.raises(KeyError, match="no modality 'c'; modalities: a, b"):
        affinity.select("c")


def test_saved_and_loaded_is_the_same(tmp_path):
    affinity = mx.Affinity.from_dense(matrix(), VIEW, ("a", "b"))
    affinity.save(tmp_path / "affinity.npz")
    loaded = mx.Affinity.load(tmp_path / "affinity.npz")
    for name in ("pairs", "scores", "view"):
        assert torch.equal(getattr(loaded, name), getattr(affinity, name))
    assert loaded.modalities == ("a", "b")
    with pytest.raises(FileNotFoundError):
        mx.Affinity.load(tmp_path / "none.npz")


def test_inputs_are_not_written_to():
    scores = torch.as_tensor(matrix())
    before = scores.clone()
    affinity = mx.Affinity.from_dense(scores, VIEW)
    affinity.dense().fill_(0)
    affinity.cost()
    assert torch.equal(scores, before)
    assert bool((affinity.scores > 0).all())


@pytest.mark.parametrize("m", [0, 1])
def test_nothing_and_one(m):
    affinity = mx.Affinity.from_dense(np.ones((m, m)), np.zeros(m, np.int64))
    assert affinity.pairs.shape == (2, 0)
    assert affinity.dense().shape == (1, m, m)
    assert affinity.cost().shape == (0,)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pairs": torch.tensor([[2], [0]])}, r"pairs: expected pairs\[0\] < pairs\[1\]"),
        ({"pairs": torch.tensor([[0], [1]])}, r"no pair within one view, got \(0, 1\)"),
        ({"pairs": torch.tensor([[0], [5]])}, "pairs: expected indices in 0..4, got 0..5"),
        ({"pairs": torch.tensor([[0.0], [2.0]])}, "pairs: expected int64"),
        ({"scores": torch.tensor([[1.5]])}, r"got 1.5 in modality 'a' for the pair \(0, 2\)"),
        ({"scores": torch.tensor([[torch.nan]])}, "got nan in modality 'a'"),
        ({"scores": torch.zeros(1, 2)}, r"scores: expected shape .* = \(1, 1\), got \(1, 2\)"),
        ({"modalities": ()}, "scores: expected shape"),
    ],
)
def test_malformed_affinities_are_refused(change, message):
    given = {
        "pairs": torch.tensor([[0], [2]]),
        "scores": torch.tensor([[0.8]]),
        "view": VIEW,
        "modalities": ("a",),
    }
    with pytest.raises(ValueError, match=message):
        mx.Affinity(**(given | change))


def test_a_repeated_pair_and_a_repeated_name_are_refused():
    pairs = torch.tensor([[0, 0], [2, 2]])
    with pytest.raises(ValueError, match=r"expected each pair once, got \(0, 2\)"):
        mx.Affinity(pairs, torch.zeros(1, 2), VIEW, ("a",))
    with pytest.raises(ValueError, match="modalities: expected different names"):
        mx.Affinity(pairs[:, :1], torch.zeros(2, 1), VIEW, ("a", "a"))


def test_malformed_matrices_are_refused():
    with pytest.raises(ValueError, match=r"scores: expected shape \(5, 5\) or \(l, 5, 5\)"):
        mx.Affinity.from_dense(np.zeros((4, 4)), VIEW)
    scores = matrix(l=1)[0]
    scores[2, 0], scores[0, 2] = 0.9, 0.1
    with pytest.raises(ValueError, match=r"symmetric matrices, got 0.1 at \(0, 2\) and 0.9"):
        mx.Affinity.from_dense(scores, VIEW)
    with pytest.raises(ValueError, match="indistinct: no observation is of view 8"):
        mx.Affinity.from_dense(matrix(), VIEW, indistinct=[8])


def test_repr_is_one_short_line():
    affinity = mx.Affinity.from_dense(matrix(), VIEW, ("iou", "color"))
    assert repr(affinity) == (
        "Affinity(5 observations in 2 views, 2 of them without a view; 9 pairs; "
        "modalities: iou, color; float64 on cpu)"
    )
