"""The README's programs do what it says: each is run as a stranger would run it."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mixer_torch.cli import main

README = Path(__file__).parents[1] / "README.md"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


def program(containing):
    return next(block for block in blocks("python") if containing in block)


def test_the_complete_script_runs_and_has_twelve_lines(tmp_path):
    script = program("ParkingLot")
    assert len([line for line in script.splitlines() if line.strip()]) <= 12
    (tmp_path / "script.py").write_text(script)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert "precision" in done.stdout
    assert "cars" in done.stdout


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_the_scorer_works_from_yaml_with_no_other_edit(folder):
    (folder / "height.py").write_text(program("class Height(Scorer)"))
    rng = np.random.default_rng(0)
    rows = ["frame,x1,y1,x2,y2,identity"]
    for frame in range(4):
        for identity, tall in enumerate((40, 80, 160)):
            x, y = rng.uniform(0, 500, 2)
            height = tall * rng.uniform(0.97, 1.03)
            rows.append(f"{frame},{x},{y},{x + 30},{y + height},{identity}")
    (folder / "seen.csv").write_text("\n".join(rows))
    (folder / "mine.yaml").write_text(
        "dataset: {class_path: mixer_torch.datasets.Table,"
        " init_args: {path: seen.csv, frame_rate: 10.0}}\n"
        "scorers:\n  - class_path: height.Height\n"
    )
    assert main(["associate", "--config", "mine.yaml", "--out", "result"]) == 0
    assert '"f1": 1.0' in (folder / "result" / "metrics.json").read_text()


def test_your_own_data_in_five_lines(folder):
    script = program("Table(")
    assert len([line for line in script.splitlines() if line.strip()]) <= 5
    (folder / "seen.csv").write_text("frame,time,x,y\n0,0,1.0,2.0\n0,0,8.0,9.0\n1,0.1,1.1,2.0\n")
    names = {}
    exec(compile(script, "README.md", "exec"), names)
    assert names["association"].labels.tolist() == [0, 1, 0]


def test_files_that_the_readme_names_exist():
    for path in re.findall(r"\]\(((?!http)[^)#]+)\)", README.read_text(encoding="utf-8")):
        assert (README.parent / path).exists(), path
