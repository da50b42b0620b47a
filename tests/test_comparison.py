"""The comparison's rows, tables and figures, on small synthetic scenes."""

import ast
import csv
import math

import pytest
import torch

import mixer_torch as mx
from mixer_torch.benchmarks import (
    comparison,
    figure_ablation,
    report,
    results,
    robustness,
    table2,
    tuning,
)
from mixer_torch.cli import main
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.solvers.threshold import AllPairs


@pytest.fixture
def small(monkeypatch):
    """Scenes in place of parking lots, and three of the algorithms."""
    names = list(reversed(comparison.MODALITIES))  # a configuration may name them in any order

    def scenes(seeds, num_frames=100):
        for seed in seeds:
            affinity, labels = synthetic(objects=4, views=4, modalities=4, seed=seed)
            named = mx.Affinity(affinity.pairs, affinity.scores, affinity.view, tuple(names))
            yield "parking_lot", seed, named, labels

    def held_out(num_frames=100):
        return scenes((7, 8))

    chosen = {key: comparison.SETTINGS[key] for key in ("All-pairs", "CLEAR", "QuickMatch")}
    chosen["MIXER"] = (AllPairs, [{}])  # in its place: it takes no time
    monkeypatch.setattr(comparison, "parking_lots", scenes)
    monkeypatch.setattr(comparison, "held_out", held_out)
    monkeypatch.setattr(comparison, "SETTINGS", chosen)
    monkeypatch.delenv("MIXER_DATA", raising=False)


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_table2_writes_rows_tables_and_figures(small, tmp_path):
    text = table2.main(["--out", str(tmp_path), "--seeds", "2", "--quick"])
    rows = rows_of(tmp_path / "rows.csv")
    assert tuple(rows[0]) == comparison.COLUMNS
    assert len(rows) == 4 * 5 + 4 * 3  # algorithms x columns, and algorithms x sizes
    assert {row["dataset"].split("_")[0] for row in rows} == {"parking", "synthetic"}
    assert (tmp_path / "table.md").read_text() == text
    assert r"\toprule" in (tmp_path / "table_parking_lot.tex").read_text()
    for name in ("time.png", "time.svg", "failures.csv"):
        assert (tmp_path / name).stat().st_size > 0


def test_everything_is_made_from_the_rows_alone(small, tmp_path):
    first = table2.main(["--out", str(tmp_path), "--quick"])
    for path in tmp_path.iterdir():
        if path.suffix != ".csv":
            path.unlink()
    assert table2.main(["--out", str(tmp_path), "--from_rows"]) == first
    assert (tmp_path / "time.svg").exists()


def test_bench_command(small, tmp_path, capsys):
    assert main(["bench", "table2", "--out", str(tmp_path), "--quick"]) == 0
    shown = capsys.readouterr().out
    assert (tmp_path / "table.md").read_text().strip() in shown
    assert f"written to {tmp_path}" in shown
    (tmp_path / "table.md").unlink()
    assert main(["bench", "table2", "--out", str(tmp_path), "--from_rows"]) == 0
    assert (tmp_path / "table.md").exists()


@pytest.mark.parametrize("name", ["table9", "report"])
def test_bench_names_what_there_is(name, capsys):
    assert main(["bench", name]) == 2
    message = capsys.readouterr().err
    assert f"got '{name}'" in message
    assert "table2" in message


def test_best_of_a_column_is_bold_and_of_the_table_underlined():
    columns = {"a": "first", "b": "second"}
    rows = [
        {"algorithm": name, "modalities": column, "seed": seed, "consistent": "True"}
        | {"precision": f1, "recall": f1, "f1": f1}
        for name, column, values in (
            ("One", "a", (0.2, 0.4)),
            ("One", "b", (0.5, 0.5)),
            ("Two", "a", (0.1, 0.3)),
            ("Two", "b", (0.9, 0.7)),
        )
        for seed, f1 in enumerate(values)
    ]
    text = report.markdown_table("scenes", rows, columns, {})
    one, two = [line for line in text.splitlines() if line.startswith(("| One", "| Two"))]
    assert "**0.30/0.30 0.300 ± 0.141**" in one
    assert "<u>**0.80/0.80 0.800 ± 0.141**</u>" in two
    assert one.count("**") == 2
    latex = report.latex_table(rows, columns, {})
    assert r"One & \textbf{0.30/0.30} & 0.50/0.50 \\" in latex
    assert r"Two & 0.20/0.20 & \underline{\textbf{0.80/0.80}} \\" in latex


def test_verdict_names_the_best_and_the_factor():
    columns = {"a": "first", "a+b": "combined"}
    values = {
        ("CLEAR", "a"): 0.5,
        ("CLEAR", "a+b"): 0.4,
        ("MIXER", "a"): 0.3,
        ("MIXER", "a+b"): 0.8,
    }
    rows = [
        {"algorithm": name, "modalities": column, "precision": f1, "recall": f1, "f1": f1}
        for (name, column), f1 in values.items()
    ]
    text = report.verdict(rows, columns)
    assert "| CLEAR | 0.500 (first) | 0.400 | -0.100 |" in text
    assert "| MIXER | 0.300 (first) | 0.800 | +0.500 |" in text
    assert "MIXER on combined" in text
    assert "a factor of 1.60" in text


def test_failures_by_hand():
    view = torch.tensor([0, 1, 2, 0, 1, 2])
    identity = torch.tensor([0, 0, 0, 1, 1, -1])
    labels = torch.tensor([0, 0, 1, 1, 2, 2])  # 0 in two parts; one cluster mixed, one with clutter
    association = mx.Association(labels, 0.0, mx.Status.CONVERGED)
    found = comparison.failures(association, evaluate(association, identity, view), identity, view)
    assert found["wrong_links"] == 2
    assert found["missed_links"] == 3
    assert found["parts_of_an_object"] == 2
    assert found["mixed_clusters"] == pytest.approx(2 / 3)
    assert found["open_cycles"] == found["within_view_links"] == 0


def test_ablation_starts_with_the_strongest_modality(small, tmp_path):
    text = figure_ablation.main(["--out", str(tmp_path), "--seeds", "2"])
    rows = results.read(tmp_path / "rows.csv")
    names = figure_ablation.order(rows)
    assert sorted(names) == sorted(comparison.MODALITIES)
    assert f"| F1 | {names[0]} | {names[0]}+{names[1]} |" in text
    assert {(tmp_path / f"ablation.{kind}").exists() for kind in ("png", "svg")} == {True}


def test_robustness_moves_one_parameter_at_a_time():
    base, _ = robustness.problem("noise", robustness.BASE["noise"], seed=3)
    for sweep, value in (("wrong", 0.2), ("missing", 0.4), ("views", 6)):
        same, _ = robustness.problem(sweep, value, seed=3)
        assert torch.equal(same.view, base.view)
        torch.testing.assert_close(same.scores, base.scores)
    more, _ = robustness.problem("views", 9, seed=3)
    assert len(more.view.unique()) > len(base.view.unique())


def test_tuning_marks_the_best_setting(small, tmp_path):
    text = tuning.main(["--out", str(tmp_path), "--quick"])
    for name in ("All-pairs", "CLEAR", "QuickMatch"):
        lines = [line for line in text.splitlines() if line.startswith(f"| {name}")]
        assert len(lines) == len(comparison.SETTINGS[name][1])
        assert sum("**" in line for line in lines) == 1
    chosen = ast.literal_eval(text.partition("CHOSEN = ")[2].strip())
    assert set(chosen["parking_lot"]) == {"All-pairs", "CLEAR", "QuickMatch"}
    bold = next(line for line in text.splitlines() if line.startswith("| CLEAR") and "**" in line)
    assert chosen["parking_lot"]["CLEAR"]["evidence"] in bold


def test_peak_memory_is_that_of_the_work_alone():
    with comparison.Peak() as peak:
        torch.ones(64, 1024, 1024 // 4).sum()  # 64 MiB
    assert math.isnan(peak.mebibytes) or 60 < peak.mebibytes < 200
