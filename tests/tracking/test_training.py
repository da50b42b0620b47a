"""Learning a tracker's weights, whole, on a few small simulated scenes."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from mixer_torch.datasets.simulated import Scene, Simulated
from mixer_torch.metrics.tracking import evaluate_tracks
from mixer_torch.tracking import Tracker, Tracks
from mixer_torch.tracking.examples import examples
from mixer_torch.tracking.training import _majority, train
from mixer_torch.tracking.weights import NETWORKS, Weights

SCENE = Scene(frames=100, things=8, speed=0.6, clutter=1.0, miss=0.05)


@pytest.fixture(scope="module")
def families():
    return {
        name: [
            one for seed in seeds for one in examples(Simulated(SCENE, seed).load(), seed, rows=600)
        ]
        for name, seeds in (("a", (10, 11)), ("b", (12, 13)))
    }


@pytest.fixture(scope="module")
def weights(families):
    told = []
    found = train(families, progress=told.append)
    assert told[0] == "objectness"
    assert told[-1] == "tracks"
    return found


def test_what_is_learned_follows_a_scene_that_it_was_not_learned_on(weights):
    seen = Simulated(SCENE, 1).load()
    true = Simulated(replace(SCENE, truth_of_hidden=False), 1, "gt").load()
    truth = Tracks.from_labels(true, true["identity"])
    assert evaluate_tracks(Tracker(weights=weights).track(seen), truth)["IDF1"] > 75


def test_objects_have_higher_odds_than_clutter_in_what_was_not_seen(weights):
    (one,) = examples(Simulated(SCENE, 2).load(), variants=1)
    odds = weights["objectness"](one.description)
    assert odds[one.identity >= 0].mean() > odds[one.identity < 0].mean() + 1


def test_all_networks_are_there_and_survive_a_file(weights, tmp_path):
    assert tuple(sorted(weights.networks)) == tuple(sorted(NETWORKS))
    weights.save(tmp_path / "own.safetensors")
    seen = Simulated(SCENE, 1).load()
    a = Tracker(weights=weights).associate(seen).labels
    b = Tracker(weights=tmp_path / "own.safetensors").associate(seen).labels
    assert (a == b).float().mean() > 0.99
    assert Weights.load(tmp_path / "own.safetensors")["joins"].features


def test_the_same_seed_learns_the_same(families):
    small = {"a": families["a"][:1]}
    a, b = (train(small) for _ in range(2))
    for name in NETWORKS:
        assert np.array_equal(a[name].hidden, b[name].hidden)


def test_the_majority_of_a_track():
    label = np.array([0, 0, 0, 1, 1, 2, 2, 3, -1])
    identity = np.array([7, 7, -1, 5, 6, -1, -1, -2, 7])
    assert _majority(label, identity).tolist() == [7, -1, -1, -1]


def test_bad_input_is_told(families):
    with pytest.raises(ValueError, match="families: expected at least one"):
        train({})
    with pytest.raises(ValueError, match="families: expected examples of 'none'"):
        train({"a": families["a"], "none": []})
    alone = [replace(one, identity=np.arange(len(one.identity))) for one in families["a"]]
    with pytest.raises(ValueError, match=r"families: 'alone' has no two detections"):
        train({"alone": alone})
    seen = Simulated(SCENE, 0).load()
    features = {name: value for name, value in seen.features.items() if name != "identity"}
    with pytest.raises(KeyError, match="identity"):
        examples(type(seen)(torch.as_tensor(seen.view), features))
