"""The embedding trained from the command line, in miniature, and what of it is chosen how."""

import csv
import json

import cv2
import numpy as np
import pytest
import torch
import yaml
from safetensors.torch import load_file

from mixer_torch.cli import main as mixer
from mixer_torch.fusion import LogOddsFusion
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.solvers.base import solve
from mixer_torch.train.cli import main as mixer_train
from mixer_torch.train.embedding import (
    CHANNEL_ORDERS,
    PRIORS,
    augmentation,
    best_prior,
    gallery,
    permute_channels,
    ranked,
)

pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture
def people(tmp_path):
    """Eight persons with a pattern each, seen by two cameras in other light."""
    generator = np.random.default_rng(0)
    for person in range(1, 9):
        (tmp_path / "people" / f"{person:03d}").mkdir(parents=True)
        pattern = generator.integers(0, 255, (8, 3, 3), dtype=np.uint8)
        for shot in range(4):
            image = cv2.resize(pattern, (24, 64), interpolation=cv2.INTER_NEAREST)
            image = (0.8 * image + generator.integers(0, 50, image.shape)).astype(np.uint8)
            name = f"{shot % 2 + 1:02d}_{shot + 1}.png"
            cv2.imwrite(str(tmp_path / "people" / f"{person:03d}" / name), image)
    found = {"class_path": "mixer_torch.datasets.Persons"}
    found["init_args"] = {"path": str(tmp_path / "people"), "balance": True}
    return found


@pytest.fixture
def config(people, tmp_path):
    sizes = {"validate": 2, "test": 3, "persons": 3, "crops": 4, "height": 64, "width": 24}
    settings = {
        "out": str(tmp_path / "run"),
        "model": {
            "class_path": "mixer_torch.train.embedding.EmbeddingTraining",
            "init_args": {"dimension": 16, "width": 4, "strips": 4, "reciprocal": 4},
        },
        "data": {
            "class_path": "mixer_torch.train.crops.CropData",
            "init_args": {"dataset": people, **sizes},
        },
        "checkpoint": {"monitor": "val/map", "mode": "max"},
        "early_stopping": {"monitor": "val/map", "mode": "max"},
        "trainer": {"max_epochs": 5, "enable_progress_bar": False, "accelerator": "cpu"},
    }
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


def test_fit_test_and_associate_by_yaml_alone(config, people, tmp_path):
    assert mixer_train(["fit", "--config", str(config)]) == 0
    assert mixer_train(["test", "--config", str(config)]) == 0
    with (tmp_path / "run" / "logs" / "version_0" / "metrics.csv").open() as file:
        losses = [float(row["train/loss"]) for row in csv.DictReader(file) if row["train/loss"]]
    assert losses[-1] < losses[0]
    metrics = json.loads((tmp_path / "run" / "test" / "metrics.json").read_text())
    people["init_args"]["skip"] = 5
    scene = tmp_path / "scene.yaml"
    scene.write_text(yaml.safe_dump({"dataset": people}))
    export = tmp_path / "run" / "export" / "scorers.yaml"
    words = ["--config", str(scene), "--config", str(export), "--out", str(tmp_path / "found")]
    assert mixer(["associate", *words]) == 0
    found = json.loads((tmp_path / "found" / "metrics.json").read_text())["all"]
    assert found["queries"] == metrics["queries"] == 12
    # Balanced by themselves, the three persons look a little other than among all eight.
    assert found["map"] == pytest.approx(metrics["map"], abs=0.1)
    fusion = yaml.safe_load(export.read_text())["fusion"]["init_args"]
    assert fusion["prior"] in PRIORS


BREAKER = """
from lightning.pytorch.callbacks import Callback

class Breaker(Callback):
    def on_train_batch_end(self, trainer, module, outputs, batch, batch_idx):
        if trainer.current_epoch == 2:
            raise ValueError("power cut")
"""


def test_interrupted_it_goes_on_to_the_same_weights(config, tmp_path, monkeypatch, capsys):
    (tmp_path / "breaker.py").write_text(BREAKER)
    monkeypatch.syspath_prepend(str(tmp_path))
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    fit = ["fit", "--config", str(config), "--trainer.max_epochs", "4", "--out"]
    assert mixer_train([*fit, str(whole)]) == 0
    assert mixer_train([*fit, str(broken), "--trainer.callbacks+=breaker.Breaker"]) == 2
    assert "power cut" in capsys.readouterr().err
    assert not (broken / "export").exists()
    assert mixer_train([*fit, str(broken), "--ckpt_path", "last"]) == 0
    for name in ("embedding", "calibrator"):
        one, other = (load_file(d / "export" / f"{name}.safetensors") for d in (whole, broken))
        for key, value in one.items():
            torch.testing.assert_close(other[key], value, rtol=0, atol=0)


def test_mistakes_are_named(config, capsys):
    for name, value in (("learning_rate", "0"), ("classification", "-1"), ("temperature", "0")):
        words = [f"--model.init_args.{name}", value]
        assert mixer_train(["fit", "--config", str(config), *words]) == 2
        assert name in capsys.readouterr().err
    assert mixer_train(["fit", "--config", str(config), "--data.init_args.test", "5"]) == 2
    assert "expected 9 identities or more, got 8" in capsys.readouterr().err


def test_the_prior_is_the_one_of_the_best_clusters():
    generator = torch.Generator().manual_seed(0)
    identity = torch.arange(5).repeat_interleave(6)
    pairs = torch.triu_indices(30, 30, offset=1)
    same = identity[pairs[0]] == identity[pairs[1]]
    # Two of the persons look alike in all their crops, so pairs by themselves join them.
    twins = (identity[pairs] < 2).all(0) & ~same
    ratio = torch.where(same, 3.0, -2.0).where(~twins, 0.8)
    ratio = ratio + 0.3 * torch.randn(len(ratio), generator=generator)
    affinity = gallery(ratio, pairs, 30)
    assert evaluate(solve(affinity, None, LogOddsFusion()), identity, affinity.view)["f1"] < 0.9
    prior = best_prior(affinity, identity)
    assert prior < 0.3
    found = solve(affinity, None, LogOddsFusion(prior=prior))
    assert evaluate(found, identity, affinity.view)["f1"] == 1


def test_permuted_channels_make_other_persons():
    crops = torch.rand(12, 3, 4, 2, generator=torch.Generator().manual_seed(0))
    number = torch.tensor([3, 3, 0, 5, 5, 5, 3, 0, 7, 7, 7, 7])
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(2)
        exchanged, label = permute_channels(crops, number, 0.6)
        same, plain = permute_channels(crops, number, 0.0)
    assert torch.equal(same, crops)
    assert torch.equal(plain, 6 * number)
    assert torch.equal(label // 6, number)
    assert len(torch.unique(label)) == 4  # each person in one way
    assert 0 < int((label % 6 > 0).sum()) < 12
    for crop, found, kind in zip(crops, exchanged, label % 6, strict=True):
        assert torch.equal(found, crop[list(CHANNEL_ORDERS[int(kind)])])


def test_ranked_by_the_evidence_of_pairs():
    batch = {"identity": torch.tensor([1, 1, 2, 2]), "camera": torch.tensor([0, 1, 0, 1])}
    pairs = torch.triu_indices(4, 4, offset=1)
    same = batch["identity"][pairs[0]] == batch["identity"][pairs[1]]
    assert ranked(same.float(), pairs, batch)["map"] == 1
    assert ranked(-same.float(), pairs, batch)["map"] == 0.5


def test_augmented_crops_are_crops_and_of_the_seed_alone():
    crops = torch.rand(6, 3, 32, 16, generator=torch.Generator().manual_seed(0))
    augment, made = augmentation(), []
    for seed in (1, 1, 2):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            made.append(augment(crops))
    assert made[0].shape == crops.shape
    assert float(made[0].min()) >= 0
    assert float(made[0].max()) <= 1
    assert torch.equal(made[0], made[1])
    assert not torch.allclose(made[0], made[2])
