"""The benchmark of persons on crops that are made here, and its rivals against scikit-learn."""

import csv

import cv2
import numpy as np
import pytest
import torch
from sklearn.cluster import AgglomerativeClustering

import mixer_torch as mx
from mixer_torch.benchmarks import persons
from mixer_torch.cli import main
from mixer_torch.metrics import adjusted_rand


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
    monkeypatch.setattr(persons, "PRIORS", (0.5, 0.2))
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
        {"method": "MIXER", "clusters": 6, "objects": 6, "prior": ""},
        *(
            {"method": "MIXER by prior", "clusters": found, "objects": 6, "prior": prior}
            for prior, found in ((0.5, 3), (0.2, 7), (0.1, 12))
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
