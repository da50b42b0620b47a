"""`mixer evaluate` of associations."""

import json
from pathlib import Path

import pytest
from command_inputs import write_config, write_table


def test_evaluate_takes_the_truth_from_the_table_itself(mixer):
    Path("r.csv").write_text("view,identity,label\n0,5,0\n0,6,1\n1,5,0\n1,6,2\n")
    code, out, _ = mixer("evaluate", "--result", "r.csv", "--out", "m.json")
    assert code == 0
    metrics = json.loads(Path("m.json").read_text())["all"]
    assert (metrics["precision"], metrics["recall"]) == (1, 0.5)
    assert "0.500" in out


def test_evaluate_puts_rows_in_order(mixer):
    write_table()
    labels = [0, 1, 2] * 3
    rows = [f"{i},{labels[i]}" for i in (4, 0, 8, 2, 1, 3, 7, 5, 6)]
    Path("r.csv").write_text("\n".join(["observation,label", *rows]) + "\n")
    assert (
        mixer("evaluate", "--result", "r.csv", "--config", write_config(), "--out", "m.json")[0]
        == 0
    )
    assert json.loads(Path("m.json").read_text())["all"]["f1"] == 1


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("view,label\n0,0\n", "'identity'"),
        ("view,identity\n0,0\n", "'label'"),
        ("view,identity,label\n0,0,\n", "line 2"),
    ],
)
def test_evaluate_names_what_is_missing(mixer, text, named):
    Path("r.csv").write_text(text)
    code, _, err = mixer("evaluate", "--result", "r.csv")
    assert code == 2
    assert named in err


@pytest.mark.parametrize(
    ("text", "named"),
    [("label\n0\n", "expected 9 rows"), ("observation,label\n" + "0,0\n" * 9, "once")],
)
def test_evaluate_wants_one_row_an_observation(mixer, text, named):
    write_table()
    Path("r.csv").write_text(text)
    code, _, err = mixer("evaluate", "--result", "r.csv", "--config", write_config())
    assert code == 2
    assert named in err
