"""k-reciprocal encoding against the sets of its definition, written out."""

import pytest
import torch

from mixer_torch.observations import Observations
from mixer_torch.pairs import Every
from mixer_torch.scorers.embedding import COSINE, Embedding
from mixer_torch.scorers.neighbours import AVERAGED, jaccard, reciprocal_encoding


def unit_vectors(m=30, d=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    own = torch.randn(m // 5, d, generator=generator).repeat_interleave(5, 0)
    vectors = own + 0.6 * torch.randn(len(own), d, generator=generator)
    return torch.nn.functional.normalize(vectors, dim=1).double()


def by_sets(vectors, k):
    """The definition of Zhong et al. 2017, observation by observation."""
    cosine = vectors @ vectors.T
    m = len(vectors)
    order = cosine.argsort(1, descending=True).tolist()

    def mutual(i, count):
        return {j for j in order[i][: count + 1] if i in order[j][: count + 1]}

    rows = torch.zeros(m, m, dtype=torch.float64)
    for i in range(m):
        base = mutual(i, k)
        chosen = set(base)
        for j in base:
            own = mutual(j, round(k / 2))
            if len(own & base) > 2 / 3 * len(own):
                chosen |= own
        members = sorted(chosen)
        rows[i, members] = cosine[i, members].exp()
    rows = rows / rows.sum(1, keepdim=True)
    return torch.stack([rows[order[i][:AVERAGED]].mean(0) for i in range(m)])


@pytest.mark.parametrize("k", [2, 5, 8, 40])
def test_against_sets(k):
    vectors = unit_vectors()
    found = reciprocal_encoding(vectors, k)
    torch.testing.assert_close(found, by_sets(vectors, k))
    torch.testing.assert_close(found.sum(1), torch.ones(30, dtype=torch.float64))


def test_jaccard_by_hand():
    encoding = torch.tensor([[0.5, 0.5, 0.0], [0.25, 0.25, 0.5], [0.0, 0.0, 1.0]])
    found = jaccard(encoding, torch.tensor([[0, 0, 1], [1, 2, 2]]))
    torch.testing.assert_close(found, torch.tensor([0.5 / 1.5, 0.0, 0.5 / 1.5]))
    assert jaccard(encoding, torch.zeros(2, 0, dtype=torch.int64)).shape == (0,)


def test_who_is_missing_is_nobodys_neighbour():
    vectors = unit_vectors()
    with_gap = torch.cat([vectors, torch.full((1, 4), torch.nan, dtype=torch.float64)])
    found = reciprocal_encoding(with_gap, 5)
    torch.testing.assert_close(found[:30, :30], reciprocal_encoding(vectors, 5))
    assert bool((found[:30, 30] == 0).all())
    assert bool(found[30].isnan().all())


@pytest.mark.parametrize("m", [0, 1, 5])
def test_few(m):
    assert reciprocal_encoding(unit_vectors()[:m], 8).shape == (m, m)


def test_the_scorer_takes_some_of_both():
    vectors = unit_vectors()
    seen = Observations(torch.full((30,), -1), {"embedding": vectors})
    pairs = Every()(seen)
    cosine, both = (Embedding(reciprocal=k).evidence(seen, pairs) for k in (0, 5))
    common = jaccard(reciprocal_encoding(vectors, 5), pairs)
    torch.testing.assert_close(both, COSINE * cosine + (1 - COSINE) * common)
    with pytest.raises(ValueError, match="reciprocal: expected an integer >= 0, got -1"):
        Embedding(reciprocal=-1)


def test_common_neighbours_tell_more_than_the_cosine():
    vectors = unit_vectors(200, 6, seed=1)
    identity = torch.arange(200) // 5
    seen = Observations(torch.full((200,), -1), {"embedding": vectors})
    pairs = Every()(seen)
    same = identity[pairs[0]] == identity[pairs[1]]
    best = []
    for k in (0, 5):
        evidence = Embedding(reciprocal=k).evidence(seen, pairs)
        best.append(float(same[evidence.topk(int(same.sum())).indices].double().mean()))
    assert best[1] > best[0]
