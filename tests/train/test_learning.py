"""Fusion, pair network and clustering trained from the command line, in miniature."""

import copy
import csv
import dataclasses
import json
import math
from types import SimpleNamespace

import pytest
import torch
import yaml

from mixer_torch.cli import main as mixer
from mixer_torch.scorers.pair_network import as_evidence, load_network
from mixer_torch.train.cli import main as mixer_train
from mixer_torch.train.data import EpochSampler, Rows, by_identity
from mixer_torch.train.dependence import dependence
from mixer_torch.train.pairs import PairTraining, parts_of_objects
from mixer_torch.train.tables import PairTable


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
    scorers = [
        {"class_path": "mixer_torch.scorers.IoU"},
        {"class_path": "mixer_torch.scorers.Proximity"},
    ]
    return {
        "out": str(tmp_path / "run"),
        "data": {
            "class_path": "mixer_torch.train.data.PairData",
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
    settings["model"] = {"class_path": "mixer_torch.train.fusion.FusionTraining"}
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
    settings["model"] = {"class_path": "mixer_torch.train.pairs.PairTraining"}
    metrics, found = fit_test_and_associate(settings, tmp_path, "scorers.yaml")
    assert found == pytest.approx(metrics["network"]["f1"])
    start = tmp_path / "run" / "export" / "pair_network.safetensors"
    settings["out"] = str(tmp_path / "through")
    settings["model"] = {
        "class_path": "mixer_torch.train.clustering.AssociationTraining",
        "init_args": {"start": str(start)},
    }
    settings["data"]["class_path"] = "mixer_torch.train.clustering.WindowData"
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


def test_members_are_trained_side_by_side_and_saved_in_one_file(settings, tmp_path):
    settings["model"] = {
        "class_path": "mixer_torch.train.pairs.PairTraining",
        "init_args": {"members": 3},
    }
    metrics, found = fit_test_and_associate(settings, tmp_path, "scorers.yaml")
    assert found == pytest.approx(metrics["network"]["f1"])
    saved = load_network(
        tmp_path / "run" / "export" / "pair_network.safetensors", ["IoU", "Proximity"]
    )
    weights = torch.stack([member.weights for member in saved.members])
    assert weights.shape == (3, 2)
    assert len(torch.unique(weights, dim=0)) == 3


def objects_table(identity):
    """All pairs of observations, in one modality that knows little, and in one that errs on 0."""
    table = make_table(identity)
    same = table.same & (identity[table.pairs[0]] >= 0)
    scores = torch.where(same, 0.8, 0.3) * torch.ones_like(table.evidence)
    scores[1, (identity[table.pairs] == 0).any(0)] = 0.5
    return dataclasses.replace(table, evidence=scores, same=same)


def started(table, members):
    """A training that has been set up, without a trainer."""

    class WithoutTrainer(PairTraining):
        data = SimpleNamespace(
            modalities=("a", "b"),
            kept=1.0,
            tables=lambda part: [table],
            replace_evidence_by_scores=lambda: None,
        )

    training = WithoutTrainer([], members=members)
    training.log = lambda *args, **options: None
    training.setup("fit")
    return training


def test_a_member_never_sees_the_objects_of_its_part():
    rows = Rows([objects_table(torch.tensor([7, 7, 3, 3, -1, 9, 9]))] * 2)
    first = rows.objects[:, : rows.objects.shape[1] // 2]
    assert sorted(torch.unique(first).tolist()) == [-1, 0, 1, 2]
    # Another sequence has other objects, even where it counts them alike; clutter is no object.
    assert sorted(torch.unique(rows.objects).tolist()) == [-1, 0, 1, 2, 3, 4, 5]
    training = PairTraining([], members=3)
    training.parts = parts_of_objects(rows.objects, 3, seed=0)
    assert torch.bincount(training.parts).tolist() == [2, 2, 2]
    seen = training.seen(rows.objects)
    for k in range(3):
        left_out = (training.parts == k).nonzero()[:, 0]
        assert torch.equal(seen[k], ~torch.isin(rows.objects, left_out).any(0))
    alone = PairTraining([], members=1)
    alone.parts = parts_of_objects(rows.objects, 1, seed=0)
    assert bool(alone.seen(rows.objects).all())


def test_a_member_learns_what_it_would_learn_alone():
    """One step of all members on all pairs is, for each, one step on the pairs that it sees."""
    table = objects_table(torch.tensor([0, 0, 1, 1, 2, 2, -1, 3, 3]))
    rows, training = Rows([table]), started(table, members=2)
    alone = copy.deepcopy(training.network)
    batch = rows[torch.arange(len(rows))]
    training.training_step(batch, 0).backward()
    for k, member in enumerate(alone.members):
        kept = training.seen(rows.objects)[k]
        same = rows.same[kept].float()
        rate = float(same.mean())
        logit = member(as_evidence(rows.evidence[:, kept]), torch.zeros(int(kept.sum()), 0))
        logit = logit.nan_to_num(0.0) + math.log(rate / (1 - rate))
        torch.nn.functional.binary_cross_entropy_with_logits(logit, same).backward()
        together = dict(training.network.members[k].named_parameters())
        for name, parameter in member.named_parameters():
            torch.testing.assert_close(together[name].grad, parameter.grad, msg=name)


@pytest.mark.parametrize(
    ("members", "identity", "message"),
    [
        (0, [0, 0, 1], "members: expected 1 or more, got 0"),
        (4, [0, 0, 1, 1], "members: expected at most one for each object, 2, got 4"),
        (2, [0, 0, 1, -1], "expected same and different pairs for each member, got 0 same"),
    ],
)
def test_too_many_members_are_refused(members, identity, message):
    with pytest.raises(ValueError, match=message):
        started(objects_table(torch.tensor(identity)), members)
