"""The benchmark of persons on crops that are made here, and its rivals against scikit-learn."""

import csv
import json
import re
from importlib import resources

import cv2
import numpy as np
import pytest
import torch
from sklearn.cluster import AgglomerativeClustering

import mixer_torch as mx
from mixer_torch.benchmarks import persons
from mixer_torch.cli import main
from mixer_torch.metrics.clustering import adjusted_rand


@pytest.fixture
def people(tmp_path, monkeypatch):
    """Six persons in clothes of their own, four crops each."""
    generator = np.random.default_rng(0)
    for person in range(1, 7):
        (tmp_path / "reid_persons" / f"{person:03d}").mkdir(parents=True)
        clothes = generator.integers(0, 255, (8, 1, 3))
        for shot in range(4):
            image = np.repeat(np.repeat(clothes, 8, 0), 24, 1)
            image = np.clip(image + generator.integers(-20, 20, image.shape), 0, 255)
            name = f"{shot % 2 + 1:02d}_{shot + 1}.png"
            path = tmp_path / "reid_persons" / f"{person:03d}" / name
            cv2.imwrite(str(path), image.astype(np.uint8))
    monkeypatch.setenv("MIXER_DATA", str(tmp_path))
    monkeypatch.setattr(persons, "GALLERIES", {"all": ()})
    monkeypatch.setattr(persons, "OFFSETS", (0.0, 1.0))
    monkeypatch.setattr(persons, "train", lambda out, quick: None)


def test_rows_first_and_the_table_from_them(people, tmp_path, capsys):
    out = tmp_path / "bench"
    assert main(["bench", "persons", "--out", str(out), "--quick"]) == 0
    assert "by colour" in capsys.readouterr().out
    with (out / "rows.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["persons"] for row in rows} == {"all"}
    assert {row["objects"] for row in rows if row["objects"]} == {"6"}
    told = [row for row in rows if "told the number" in row["method"]]
    assert all(int(row["clusters"]) <= 6 for row in told)
    assert float(rows[0]["f1"]) > 0.5
    before = (out / "table.md").read_text()
    assert before.count("| MIXER") == 2
    (out / "table.md").unlink()
    assert main(["bench", "persons", "--out", str(out), "--from_rows"]) == 0
    assert (out / "table.md").read_text() == before


def test_of_mixers_answers_the_one_nearest_to_the_number_is_taken():
    rows = [
        {"method": "MIXER", "clusters": 6, "objects": 6, "offset": ""},
        *(
            {"method": "MIXER by offset", "clusters": found, "objects": 6, "offset": offset}
            for offset, found in ((-1.0, 3), (0.0, 7), (2.0, 12))
        ),
    ]
    assert persons.told_the_number(rows)["clusters"] == 7


@pytest.mark.parametrize("kind", persons.LINKAGES)
def test_linkage_agrees_with_scikit_learn(kind):
    generator = torch.Generator().manual_seed(0)
    scores = torch.rand(20, 20, generator=generator)
    affinity = mx.Affinity.from_dense((scores + scores.T) / 2, torch.full((20,), -1))
    cost = affinity.cost().double().numpy()
    full = np.zeros((20, 20))
    full[tuple(affinity.pairs.numpy())] = cost
    full = full + full.T
    for number, threshold in ((4, None), (None, 0.0)):
        found = persons.hierarchical(cost, kind, number)
        expected = AgglomerativeClustering(
            n_clusters=number, distance_threshold=threshold, metric="precomputed", linkage=kind
        ).fit(full)
        labels = torch.from_numpy(expected.labels_), torch.from_numpy(found.astype(np.int64))
        assert adjusted_rand(*labels) == 1


def associated(tmp_path, *words):
    config = resources.files("mixer_torch.configs") / "persons.yaml"
    out = tmp_path / "found"
    assert main(["associate", "--config", str(config), "--out", str(out), *words]) == 0
    return json.loads((out / "metrics.json").read_text())["all"]


def test_the_configuration_by_colour(people, tmp_path, capsys):
    found = associated(tmp_path)
    assert {"f1", "bcubed_f1", "rank1", "rank5", "map"} <= set(found)
    assert found["queries"] == 24
    assert found["map"] > 0.5
    assert re.search(r"bcubed f1 +rank1 +map", capsys.readouterr().out)


@pytest.mark.real_data
def test_colour_of_real_persons(real_data, tmp_path):
    found = associated(tmp_path, "--dataset.skip", "46")
    assert found["queries"] == 256
    assert found["rank1"] > 0.35
    assert found["f1"] > 0.3
    cast = associated(tmp_path, "--dataset.skip", "46", "--dataset.balance", "false")
    assert cast["map"] < 0.8 * found["map"]
