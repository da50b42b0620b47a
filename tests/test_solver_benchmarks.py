"""The benchmarks of the solver on small problems, and the peer that they compare with."""

import numpy as np
import pytest

from mixer_torch.benchmarks import kernighan_lin, quality, results, scaling, sensitivity, table1
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.exact import Exact
from mixer_torch.solvers.problem import problem_of
from mixer_torch.solvers.search import iterated_local_search, subproblem
from mixer_torch.solvers.search.graph import Graph
from mixer_torch.solvers.search.greedy import greedy


@pytest.mark.parametrize("seed", range(4))
def test_the_peer_contracts_as_the_solver_does_and_improves_on_it(seed):
    problem = problem_of(synthetic(5, 5, noise=0.5, wrong=0.2, seed=seed)[0])
    cost = problem.cost.double().numpy()
    edges = kernighan_lin.graph_of(problem.pairs.numpy(), cost, problem.view.numpy())
    graph = Graph.from_problem(problem)
    contracted = kernighan_lin.gaec(*edges)
    improved = kernighan_lin.klj(*edges, contracted)
    assert graph.is_feasible(contracted)
    assert graph.is_feasible(improved)
    assert graph.objective(contracted) == pytest.approx(graph.objective(greedy(graph)))
    bound = Exact().run(problem).lower_bound
    assert bound - 1e-6 <= graph.objective(improved) <= graph.objective(contracted)


def test_the_peer_joins_splits_and_moves():
    pairs = np.array(np.triu_indices(4, 1))
    two = np.where((pairs[0] < 2) == (pairs[1] < 2), -1.0, 1.0)
    alone = np.full(4, -1)
    for start in ([0, 1, 2, 3], [0, 0, 0, 0], [0, 1, 0, 1], [0, 0, 0, 1]):
        edges = kernighan_lin.graph_of(pairs, two, alone)
        found = kernighan_lin.klj(*edges, np.array(start))
        assert (found[:, None] == found).tolist() == [
            [a // 2 == b // 2 for b in range(4)] for a in range(4)
        ]
    distinct = kernighan_lin.graph_of(pairs, -np.ones(6), np.array([0, 0, 1, 1]))
    found = kernighan_lin.klj(*distinct, np.arange(4))
    assert found[0] != found[1]
    assert found[2] != found[3]
    assert len(set(found)) == 2


def test_quality_makes_its_table_from_its_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(quality, "SIZES", (12,))
    rows = list(quality.run(2, 1, 5, 10))
    assert {row["feasible"] for row in rows} == {1}
    assert len(rows) == 3 * 2 + 3
    results.write(tmp_path / "rows.csv", quality.COLUMNS, rows)
    text = quality.main(["--out", str(tmp_path), "--from_rows"])
    assert text == (tmp_path / "table.md").read_text()
    assert "9 problems, 9 answers feasible" in text
    assert "| four modalities | 2 |" in text


def test_table1_has_both_solvers_and_the_naive_formulation(tmp_path):
    rows = list(table1.run((2, 4), 2, 1, 20, 20))
    assert len(rows) == 2 * 2 * 2 * 2  # levels, numbers of views, trials, solvers
    assert {row["status"] for row in rows} == {"OPTIMAL"}
    assert min(row["gap"] for row in rows) > -1e-4
    assert max(row["gap"] for row in rows if row["solver"] == "Mixer()") < 1e-3
    results.write(tmp_path / "rows.csv", table1.COLUMNS, rows)
    text = table1.main(["--out", str(tmp_path), "--from_rows"])
    assert text.count("| Mixer() |") == 4
    assert "naive, seconds" in text
    assert "252 | 685.2" in text


def test_scaling_compares_with_the_peer(tmp_path):
    rows = [
        *scaling.step("degree", 4, 0, "cpu"),
        *scaling.step("dense", 60, 1, "cpu"),
        *scaling.step("batch", 3, 0, "cpu"),
    ]
    assert [row["series"] for row in rows] == ["degree", "dense", "batch", "one by one"]
    for row in rows:
        assert row["objective"] <= row["objective_klj"] + 1e-6 <= row["objective_greedy"] + 2e-6
    results.write(tmp_path / "rows.csv", scaling.COLUMNS, rows)
    text = scaling.main(["--out", str(tmp_path), "--from_rows"])
    assert "GAEC + KLj" in text
    assert (tmp_path / "scaling.png").stat().st_size > 0


def test_sensitivity_changes_one_number_and_makes_its_table(tmp_path):
    before = subproblem.SETTINGS
    (first, *_), key = sensitivity.settings_with("sweeps", 10), before.sweeps
    with first:
        assert before._replace(sweeps=10) == iterated_local_search.SETTINGS
    assert iterated_local_search.SETTINGS.sweeps == key
    rows = [
        dict(zip(sensitivity.COLUMNS, ("search", name, 1, factor, 0, answer, 2.0), strict=True))
        for name, factor, answer in (("as set", 1, -4.0), ("cold", 0.5, -3.0), ("cold", 2, -4.0))
    ]
    results.write(tmp_path / "rows.csv", sensitivity.COLUMNS, rows)
    text = sensitivity.main(["--out", str(tmp_path), "--from_rows"])
    assert "| search | cold | +25.0000 | 1.00 | +0.0000 | 1.00 |" in text
