"""The pair network: naive Bayes at the start, its file, and what it abstains from."""

import pytest
import torch

import mixer_torch as mx
from mixer_torch.observations import Observations
from mixer_torch.scorers import IoU, Proximity
from mixer_torch.scorers.calibrators import load_calibrator
from mixer_torch.scorers.pair_network import (
    EvidenceEnsemble,
    EvidenceNetwork,
    PairNetwork,
    load_network,
    save_network,
)


@pytest.fixture
def seen():
    generator = torch.Generator().manual_seed(0)
    corner = torch.rand(8, 2, generator=generator) * 20
    return Observations(
        torch.arange(8) // 2,
        {
            "frame": torch.arange(8) // 2,
            "time": (torch.arange(8) // 2).double(),
            "box": torch.cat([corner, corner + 15], 1),
            "position": torch.randn(8, 3, generator=generator),
        },
    )


def test_untrained_it_is_naive_bayes(seen):
    scorers = [IoU(), Proximity()]
    pairs = mx.Every()(seen)
    affinity = mx.score(seen, scorers, pairs)
    expected = torch.sigmoid(-affinity.cost(mx.LogOddsFusion(cap=8.0)))
    found = PairNetwork(scorers=scorers)(seen, pairs).detach()
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)


def test_nothing_known_says_nothing(seen):
    nowhere = seen.with_features(position=torch.full((8, 3), torch.nan))
    scores = PairNetwork(scorers=[IoU(), Proximity()])(nowhere, mx.Every()(seen)).detach()
    frame = seen["frame"][mx.Every()(seen)]
    far = (frame[0] - frame[1]).abs() > 1
    assert bool((scores[far] == 0.5).all())
    assert bool((scores[~far] != 0.5).any())


def test_saved_and_loaded(seen, tmp_path):
    network = EvidenceNetwork(2, ["time_gap", "size_ratio"], width=5)
    network.covariates.learn(torch.rand(30, 2, dtype=torch.float64))
    torch.nn.init.normal_(network.out.weight, generator=torch.Generator().manual_seed(3))
    path = tmp_path / "pairs.safetensors"
    save_network(path, network, ["IoU", "Proximity"])
    scorer = PairNetwork(path, [IoU(), Proximity()])
    assert set(scorer.needs) == {"box", "frame", "position", "time"}
    direct = PairNetwork(scorers=[IoU(), Proximity()])
    direct.network = network
    pairs = mx.Every()(seen)
    torch.testing.assert_close(scorer(seen, pairs), direct(seen, pairs).detach(), rtol=0, atol=0)


def test_an_ensemble_is_the_mean_of_its_members(seen, tmp_path):
    generator = torch.Generator().manual_seed(0)
    members = [EvidenceNetwork(2, ["time_gap"], width=4) for _ in range(3)]
    for member in members:
        torch.nn.init.normal_(member.out.weight, generator=generator)
    path = tmp_path / "pairs.safetensors"
    save_network(path, EvidenceEnsemble(members), ["IoU", "Proximity"])
    pairs = mx.Every()(seen)
    found = torch.logit(PairNetwork(path, [IoU(), Proximity()])(seen, pairs))
    each = []
    for member in members:
        save_network(path, member, ["IoU", "Proximity"])
        each.append(torch.logit(PairNetwork(path, [IoU(), Proximity()])(seen, pairs)))
    torch.testing.assert_close(found, torch.stack(each).mean(0), rtol=1e-4, atol=1e-4)
    assert (torch.stack(each).std(0) > 0.01).any()
    with pytest.raises(ValueError, match="one or more networks of the same covariates"):
        EvidenceEnsemble([EvidenceNetwork(2), EvidenceNetwork(2, ["time_gap"])])
    with pytest.raises(ValueError, match="one or more networks"):
        EvidenceEnsemble([])


def test_bad_files_are_named(tmp_path):
    path = tmp_path / "pairs.safetensors"
    with pytest.raises(FileNotFoundError, match="pairs"):
        PairNetwork(path)
    save_network(path, EvidenceNetwork(2), ["IoU", "SIFT"])
    with pytest.raises(ValueError, match="trained for the scorers IoU, SIFT, got Proximity"):
        PairNetwork(path)
    with pytest.raises(ValueError, match="expected a file of kind"):
        load_calibrator(path)
    (member,) = load_network(path, ["IoU", "SIFT"]).members
    assert member.weights.tolist() == [1.0, 1.0]
