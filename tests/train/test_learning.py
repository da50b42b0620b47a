"""Fusion, pair network and clustering trained from the command line, in miniature."""

import csv
import json

import pytest
import torch
import yaml

from mixer_torch.cli import main as mixer
from train.cli import main as mixer_train
from train.data import EpochSampler, by_identity
from train.dependence import dependence
from train.tables import PairTable


def write_table(path, seed, objects=7, frames=8):
    generator = torch.Generator().manual_seed(seed)
    place = 2.5 * torch.randn(objects, 3, generator=generator)
    size = 20 + 60 * torch.rand(objects, generator=generator)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "time", "x", "y", "z", "x1", "y1", "x2", "y2", "identity"])
        for frame in range(frames):
            seen = place + 0.6 * torch.randn(objects, 3, generator=generator)
            for k in range(objects):
                x, y, s = 100 * k + 4 * frame, 50.0, float(size[k])
                box = [x, y, x + s, y + s]
                writer.writerow([frame, frame / 10, *seen[k].tolist(), *box, k])


@pytest.fixture
def settings(tmp_path):
    datasets = {}
    for seed, part in enumerate(("train", "validate", "test")):
        write_table(tmp_path / f"{part}.csv", seed)
        init_args = {"path": str(tmp_path / f"{part}.csv")}
        datasets[part] = [{"class_path": "mixer_torch.datasets.Table", "init_args": init_args}]
    scorers = [{"class_path": "scorers.IoU"}, {"class_path": "scorers.Proximity"}]
    return {
        "out": str(tmp_path / "run"),
        "data": {
            "class_path": "train.data.PairData",
            "init_args": {"scorers": scorers, **datasets},
        },
        "trainer": {"max_epochs": 4, "enable_progress_bar": False, "accelerator": "cpu"},
    }


def fit_test_and_associate(settings, tmp_path, exported):
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump(settings))
    assert mixer_train(["fit", "--config", str(path)]) == 0
    assert mixer_train(["test", "--config", str(path)]) == 0
    scene = {"dataset": settings["data"]["init_args"]["test"][0]}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    words = ["associate", "--config", str(tmp_path / "scene.yaml"), "--config"]
    words += [str(tmp_path / "run" / "export" / exported), "--out", str(tmp_path / "found")]
    assert mixer(words) == 0
    metrics = json.loads((tmp_path / "run" / "test" / "metrics.json").read_text())
    found = json.loads((tmp_path / "found" / "metrics.json").read_text())["all"]["f1"]
    return metrics, found


def test_fusion(settings, tmp_path, capsys):
    settings["model"] = {"class_path": "train.fusion.FusionTraining"}
    settings["checkpoint"] = {"monitor": "val/f1", "mode": "max"}
    settings["early_stopping"] = {"monitor": "val/f1", "mode": "max"}
    metrics, found = fit_test_and_associate(settings, tmp_path, "fusion.yaml")
    exported = yaml.safe_load((tmp_path / "run" / "export" / "fusion.yaml").read_text())["fusion"]
    kinds = {"linear": "Linear", "log odds": "LogOdds", "trained": "LogOdds"}
    of_that_kind = [
        metrics[name]["f1"]
        for name, kind in kinds.items()
        if exported["class_path"] == f"mixer_torch.{kind}Fusion"
    ]
    assert any(found == pytest.approx(f1) for f1 in of_that_kind)
    assert "exported, as best in validation" in capsys.readouterr().out
    report = json.loads((tmp_path / "run" / "test" / "dependence.json").read_text())
    assert report["worth"]["all"] == pytest.approx(metrics["trained"]["f1"])
    assert set(report["worth"]) == {"all", "without IoU", "without Proximity"}
    assert set(report["dependence"]) == {"same", "different"}


def test_pair_network_and_on_through_the_clustering(settings, tmp_path):
    settings["model"] = {"class_path": "train.pairs.PairTraining"}
    metrics, found = fit_test_and_associate(settings, tmp_path, "scorers.yaml")
    assert found == pytest.approx(metrics["network"]["f1"])
    start = tmp_path / "run" / "export" / "pair_network.safetensors"
    settings["out"] = str(tmp_path / "through")
    settings["model"] = {
        "class_path": "train.clustering.AssociationTraining",
        "init_args": {"start": str(start)},
    }
    settings["data"]["class_path"] = "train.clustering.WindowData"
    settings["data"]["init_args"] |= {"views": 4, "stride": 4}
    settings["trainer"]["max_epochs"] = 1
    path = tmp_path / "through.yaml"
    path.write_text(yaml.safe_dump(settings))
    assert mixer_train(["fit", "--config", str(path)]) == 0
    assert (tmp_path / "through" / "export" / "scorers.yaml").is_file()


def make_table(identity):
    from mixer_torch.observations import Observations

    m = len(identity)
    pairs = torch.triu_indices(m, m, 1)
    same = identity[pairs[0]] == identity[pairs[1]]
    evidence = torch.rand(2, pairs.shape[1], generator=torch.Generator().manual_seed(0))
    seen = Observations(torch.arange(m), {"identity": identity})
    return PairTable(seen, pairs, evidence, {}, same)


def test_no_object_is_in_two_parts():
    identity = torch.arange(40) % 10
    train, held = by_identity(make_table(identity), 0.3, seed=1)
    one, other = (set(identity[table.pairs].flatten().tolist()) for table in (train, held))
    assert not one & other
    assert len(other) == 3
    assert len(one) == 7


def test_order_depends_on_seed_and_epoch_alone():
    same = torch.arange(100) < 10
    sampler, again = (EpochSampler(same, 3, 16, seed=4) for _ in range(2))
    again.set_epoch(1)
    first, second = torch.cat(list(sampler)), torch.cat(list(again))
    assert not torch.equal(first, second)
    sampler.set_epoch(1)
    assert torch.equal(torch.cat(list(sampler)), second)
    assert len(sampler) == len(list(sampler))
    assert len(first) == 40
    assert sampler.kept == pytest.approx(30 / 90)
    assert set(range(10)) <= set(first.tolist())


def test_processes_share_an_epoch():
    same = torch.arange(100) < 10
    for processes in (1, 2, 3):
        ranks = [EpochSampler(same, 3, 16, 4, rank, processes) for rank in range(processes)]
        for sampler in ranks:
            sampler.set_epoch(2)
        whole = EpochSampler(same, 3, 16, seed=4)
        whole.set_epoch(2)
        found = [list(sampler) for sampler in ranks]
        assert [len(batches) for batches in found] == [len(sampler) for sampler in ranks]
        assert len({len(batches) for batches in found}) == 1
        pairs = set(torch.cat([batch for batches in found for batch in batches]).tolist())
        assert pairs == set(torch.cat(list(whole)).tolist())


def test_dependence_of_copies_is_one():
    table = make_table(torch.arange(30) % 5)
    copied = PairTable(
        table.observations,
        table.pairs,
        torch.stack([table.evidence[0], table.evidence[0], table.evidence[1]]),
        {},
        table.same,
    )
    report = dependence([copied], ["a", "b", "c"])
    for kind in ("same", "different"):
        assert report[kind]["a and b"] == pytest.approx(1.0)
        assert abs(report[kind]["a and c"]) < 0.4
