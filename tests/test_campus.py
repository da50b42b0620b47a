"""The benchmark on two cameras: counts against the metrics, baselines against brute force."""

from itertools import permutations

import numpy as np
import pytest
import torch

from mixer_torch.benchmarks import campus, results
from mixer_torch.metrics.clustering import pairwise
from mixer_torch.observations import Observations


def crowd(seed=0, m=60):
    """Places and identities at random, some of them clutter, in two cameras and three seconds."""
    generator = np.random.default_rng(seed)
    camera, second = generator.integers(0, 2, m), generator.integers(0, 3, m)
    frame = second * campus.STEP
    features = {
        "camera": camera,
        "frame": frame,
        "time": frame / 29.97,
        "identity": generator.integers(-1, 6, m),
        "position": np.concatenate([generator.uniform(0, 3, (m, 2)), np.zeros((m, 1))], 1),
        "velocity": generator.normal(0, 1, (m, 3)) * [1, 1, 0],
    }
    tensors = {name: torch.from_numpy(value) for name, value in features.items()}
    return Observations(torch.from_numpy(frame * 2 + camera), tensors)


@pytest.mark.parametrize("seed", range(3))
def test_counts_are_those_of_the_metrics(seed):
    seen = crowd(seed)
    labels = torch.from_numpy(np.random.default_rng(seed + 9).integers(0, 6, len(seen)))
    everything = np.ones(len(seen), dtype=bool)
    found = campus.counts(seen, labels, everything, across=False)
    expected = pairwise(labels, seen["identity"], seen.view)
    assert found["declared"] == expected["declared_pairs"]
    assert found["true"] == expected["true_pairs"]
    assert campus.f1([found]) == pytest.approx(expected["f1"])


def test_readings_by_hand():
    # Person 4 is seen by both cameras in frame 0 and by the first in frame 30; 5 by the second.
    columns = {"camera": [0, 1, 0, 1, 1], "frame": [0, 0, 30, 0, 30], "identity": [4, 4, 4, 5, -1]}
    features = {name: torch.tensor(value) for name, value in columns.items()}
    seen = Observations(features["frame"] * 2 + features["camera"], features)
    both = campus.shared(seen)
    assert both.tolist() == [True, True, False, False, False]
    everything, one = np.ones(5, dtype=bool), np.zeros(5)
    of = {
        reading: campus.counts(
            seen, one, both if how.get("shared") else everything,
            **{key: value for key, value in how.items() if key != "shared"},
        )
        for reading, how in campus.READINGS.items()
    }  # fmt: skip
    assert of["same frame, shared"] == {"correct": 1, "declared": 1, "true": 1}
    assert of["same frame, all"] == {"correct": 1, "declared": 3, "true": 1}
    assert of["any frame, shared"] == {"correct": 1, "declared": 1, "true": 1}
    assert of["any frame, all"] == {"correct": 2, "declared": 6, "true": 2}
    assert of["all pairs"] == {"correct": 3, "declared": 9, "true": 3}


@pytest.mark.parametrize("seed", range(5))
def test_matching_rules(seed):
    distance = np.random.default_rng(seed).uniform(0, 2, (3, 4))
    row, column = campus.nearest(distance, 1.0)
    expected = {
        (i, j)
        for i in range(3)
        for j in range(4)
        if distance[i, j] == distance[i].min() == distance[:, j].min() and distance[i, j] < 1
    }
    assert set(zip(row.tolist(), column.tolist(), strict=True)) == expected
    row, column = campus.assigned(distance, 1.0)
    cost = np.minimum(distance, 1)
    best = min(cost[range(3), chosen].sum() for chosen in permutations(range(4), 3))
    assert cost[row, column].sum() + 3 - len(row) == pytest.approx(best)
    assert (distance[row, column] < 1).all()
    for rule in (campus.nearest, campus.assigned):
        assert rule(np.empty((0, 4)), 1.0).shape == rule(np.empty((2, 0)), 1.0).shape == (2, 0)


def test_links_within_a_frame_stay_there_and_chains_go_on():
    seen = crowd()
    labels = campus.linked(seen, 1.0)
    frame = seen["frame"].numpy()
    assert all(len(set(frame[labels == k])) == 1 for k in np.unique(labels))
    chained = campus.linked(seen, 1.0, reach=1.0)
    assert len(np.unique(chained)) < len(np.unique(labels))
    # Who is linked within a frame is so in the chain, too.
    assert all(len(set(chained[labels == k])) == 1 for k in np.unique(labels))


def test_tables_are_made_from_rows(tmp_path):
    def row(method, setting, part, correct):
        names = dict(zip(campus.COLUMNS[:4], (method, setting, part, 0), strict=True))
        counts = {"correct": correct, "declared": 10, "true": 10}
        return [names | {"reading": reading} | counts for reading in campus.READINGS]

    rows = []
    for part, narrow, wide in (("first third", 5, 7), ("rest", 9, 4), ("whole", 7, 6)):
        rows += row("nearest neighbour", 0.5, part, narrow)
        rows += row("nearest neighbour", 2.5, part, wide)
        rows += row("MIXER", "", part, 8)
    results.write(tmp_path / "rows.csv", campus.COLUMNS, rows)
    fact = {"fact": "people", "start": 0, "value": 57}
    results.write(tmp_path / "facts.csv", campus.FACTS, [fact])
    text = campus.main(["--from_rows", "--out", str(tmp_path)])
    # The setting that is best on the first third is the one shown for the rest.
    tables = text.split("\n\n")
    assert "| nearest neighbour | 0.400 (2.5) |" in next(t for t in tables if "| rest |" in t)
    assert "| MIXER | 0.800 |" in text
    assert "| people | 57 |" in text
    assert (tmp_path / "table.md").read_text() == text


@pytest.mark.real_data
def test_quick_run(tmp_path):
    text = campus.main(["--quick", "--out", str(tmp_path)])
    whole = next(table for table in text.split("\n\n") if "| whole |" in table)
    cells = {line.split(" | ")[0].strip("| "): line.split(" | ")[1:] for line in whole.split("\n")}
    mixer, chained = ([float(cell.split()[0].strip("| ")) for cell in cells[name]]
                      for name in ("MIXER", "nearest neighbour, chained"))  # fmt: skip
    assert mixer[0] > 0.95
    assert all(ours > theirs for ours, theirs in zip(mixer[2:], chained[2:], strict=True))
