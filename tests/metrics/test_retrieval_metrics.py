import math
import sys

import numpy as np
import pytest
import torch
from sklearn.metrics import average_precision_score

import mixer_torch as mx
from mixer_torch.metrics.retrieval import retrieval, retrieval_of_affinity


def random_case(seed, m=37, levels=1000):
    generator = np.random.default_rng(seed)
    similarity = generator.integers(0, levels, (m, m)) / levels
    similarity = similarity + similarity.T
    return similarity, generator.integers(-1, 6, m), generator.integers(0, 3, m)


def by_brute_force(similarity, identity, camera):
    """Sorted lists query by query, strangers before true matches where they tie."""
    firsts, precisions = [], []
    for q in range(len(identity)):
        gallery = [j for j in range(len(identity)) if camera[j] != camera[q]]
        true = [j for j in gallery if identity[j] == identity[q] >= 0]
        if not true:
            continue
        order = sorted(gallery, key=lambda j: (-similarity[q, j], j in true))
        firsts.append(1 + next(place for place, j in enumerate(order) if j in true))
        hits = [j in true for j in gallery]
        precisions.append(average_precision_score(hits, similarity[q, gallery]))
    return firsts, precisions


@pytest.mark.parametrize("levels", [1000, 4])
@pytest.mark.parametrize("seed", range(4))
def test_against_sorted_lists_and_scikit_learn(seed, levels):
    similarity, identity, camera = random_case(seed, levels=levels)
    firsts, precisions = by_brute_force(similarity, identity, camera)
    found = retrieval(similarity, identity, camera, ranks=(1, 3))
    assert found["queries"] == len(firsts)
    assert found["rank1"] == pytest.approx(np.mean(np.array(firsts) <= 1))
    assert found["rank3"] == pytest.approx(np.mean(np.array(firsts) <= 3))
    assert found["map"] == pytest.approx(np.mean(precisions))


def test_in_parts_it_is_the_same(monkeypatch):
    case = random_case(0)
    whole = retrieval(*case)
    monkeypatch.setattr(sys.modules[retrieval.__module__], "CHUNK", 5)
    assert retrieval(*case) == pytest.approx(whole)


def test_a_case_worked_by_hand():
    # Query 0 finds its matches at places 1 and 3: (1 + 2/3) / 2. Those two find it first. The
    # stranger 2 has nothing to find, and 4, of its own camera alone, neither.
    similarity = torch.zeros(5, 5)
    similarity[0] = torch.tensor([9.0, 0.9, 0.8, 0.7, 9.0])
    similarity[1, 0] = similarity[3, 0] = 1.0
    identity, camera = torch.tensor([7, 7, 3, 7, 4]), torch.tensor([0, 1, 1, 1, 0])
    found = retrieval(similarity, identity, camera)
    assert found["queries"] == 3
    assert found["rank1"] == 1
    assert found["map"] == pytest.approx(((1 + 2 / 3) / 2 + 1 + 1) / 3)


def test_what_all_have_in_common_finds_nothing():
    identity, camera = torch.arange(6) % 3, torch.arange(6) // 3
    found = retrieval(torch.ones(6, 6), identity, camera, ranks=(1, 2, 3))
    assert (found["rank1"], found["rank2"], found["rank3"]) == (0, 0, 1)
    assert found["map"] == pytest.approx(1 / 3)


@pytest.mark.parametrize("m", [0, 1, 4])
def test_without_a_query_there_is_no_figure(m):
    found = retrieval(torch.ones(m, m), torch.arange(m), torch.zeros(m, dtype=torch.int64))
    assert found["queries"] == 0
    assert math.isnan(found["rank1"])
    assert math.isnan(found["map"])


def test_errors():
    identity = torch.arange(3)
    with pytest.raises(ValueError, match=r"similarity: expected shape \(3, 3\)"):
        retrieval(torch.ones(3, 2), identity, identity)
    with pytest.raises(ValueError, match="identity, camera: expected one length"):
        retrieval(torch.ones(3, 3), identity, identity[:2])
    with pytest.raises(ValueError, match=r"similarity: .*NaN"):
        retrieval(torch.full((3, 3), torch.nan), identity, identity)
    with pytest.raises(ValueError, match=r"ranks: expected"):
        retrieval(torch.ones(3, 3), identity, identity, ranks=(0,))


def gallery(seed=0, m=20):
    generator = torch.Generator().manual_seed(seed)
    features = {"identity": torch.arange(m) % 5, "camera": torch.arange(m) % 2}
    seen = mx.Observations(torch.full((m,), -1), features)
    scores = torch.rand(2, m * (m - 1) // 2, generator=generator)
    return seen, mx.Affinity(mx.Every()(seen), scores, seen.view, ("A", "B"))


def test_of_an_affinity_it_ranks_by_the_fused_cost():
    seen, affinity = gallery()
    dense = affinity.dense().double()
    for fusion in (mx.LinearFusion(), mx.LogOddsFusion({"A": 0.3}, cap=50.0)):
        by_hand = -fusion(dense.flatten(1).clamp(1e-9, 1 - 1e-9), affinity.modalities)
        expected = retrieval(by_hand.reshape(20, 20), seen["identity"], seen["camera"])
        assert retrieval_of_affinity(affinity, seen, fusion) == pytest.approx(expected, abs=1e-3)


def test_pairs_that_are_not_listed_have_nothing_to_say():
    seen, affinity = gallery()
    kept = torch.rand(affinity.pairs.shape[1], generator=torch.Generator().manual_seed(1)) < 0.4
    sparse = mx.Affinity(affinity.pairs[:, kept], affinity.scores[:, kept], seen.view, ("A", "B"))
    dense = sparse.dense().sum(0)
    expected = retrieval(dense, seen["identity"], seen["camera"])
    assert retrieval_of_affinity(sparse, seen) == pytest.approx(expected, abs=1e-3)


def test_it_is_for_galleries_of_several_cameras_alone():
    seen, affinity = gallery()
    one = seen.with_features(camera=torch.zeros(20, dtype=torch.int64))
    unknown = seen.with_features(identity=torch.full((20,), -1))
    in_views = mx.Observations(torch.arange(20), dict(seen.features))
    bare = mx.Observations(seen.view, {"identity": seen["identity"]})
    for other in (one, unknown, in_views, bare):
        assert retrieval_of_affinity(affinity, other) is None
