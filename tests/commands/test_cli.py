"""What all commands have in common: options, help, exit codes, and how little is imported."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from command_inputs import write_config, write_table


@pytest.mark.parametrize(
    ("argv", "named"),
    [
        (["solve", "none.npz"], "none.npz"),
        (["solve", "own_scorers.py"], "own_scorers.py is not a readable npz"),
        (["solve", "none.npz", "--out", "x.txt"], "x.txt"),
        (["score", "--config", "config.yaml", "--out", "x.txt"], "x.txt"),
        (["associate", "--config", "config.yaml"], "out"),
        (["paint"], "paint"),
    ],
)
def test_other_commands_name_mistakes_too(mixer, argv, named):
    write_table()
    write_config()
    code, _, err = mixer(*argv)
    assert code == 2
    assert named in err


def test_list_shows_what_there_is_with_a_summary_of_each(mixer):
    code, out, _ = mixer("list")
    assert code == 0
    lines = {line.split()[0]: line.split(maxsplit=1)[1:] for line in out.splitlines() if line}
    for path in ("mixer_torch.scorers.IoU", "mixer_torch.Mixer", "mixer_torch.datasets.Table"):
        assert lines[path][0], path
    assert "does not load" not in out


@pytest.mark.parametrize(
    "command", ["demo", "associate", "score", "solve", "track", "evaluate", "bench", "list"]
)
def test_help_explains_every_option(mixer, command):
    code, out, _ = mixer(command, "--help")
    assert code == 0
    assert "usage: mixer" in out


def test_demo_has_all_it_needs_from_any_folder(mixer):
    code, out, _ = mixer("demo", "--print_config")
    assert code == 0
    config = yaml.safe_load(out)
    assert config["out"] == "out/demo"
    assert config["ablate"] is True
    scorers = [scorer["class_path"] for scorer in config["scorers"]]
    assert scorers == [
        f"mixer_torch.scorers.{name}" for name in ("IoU", "Proximity", "Color", "SIFT")
    ]


ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "configs").glob("*.yaml")), ids=lambda path: path.stem
)
def test_configurations_of_the_project_are_valid_and_name_classes_alone(mixer, path):
    command = ("track", "sequence") if path.stem == "track" else ("associate",)
    code, _, err = mixer(*command, "--config", path, "--out", "out", "--print_config")
    assert code == 0, err
    assert "class_path: mixer_torch" not in path.read_text()


def test_bare_class_names_on_the_command_line_and_in_yaml(mixer):
    write_table()
    config = write_config(dataset={"class_path": "Table", "init_args": {"path": "seen.csv"}})
    words = [
        "--solver",
        "Exact",
        "--pairs",
        "Within",
        "--pairs.window",
        "2",
        "--fusion",
        "LogOddsFusion",
    ]
    code, out, err = mixer(
        "associate", "--config", config, "--out", "out", *words, "--print_config"
    )
    assert code == 0, err
    found = yaml.safe_load(out)
    assert found["dataset"]["class_path"] == "mixer_torch.datasets.Table"
    assert found["scorers"][0]["class_path"] == "own_scorers.Depth"
    assert found["solver"]["class_path"] == "mixer_torch.Exact"
    assert found["pairs"]["init_args"]["window"] == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--solver", "Mixr"], "did you mean Mixer?"),
        (["--solver", "mixer_torch.Mixr"], "did you mean Mixer?"),
        (["--solver", "IoU"], "mixer_torch.scorers.IoU is one of the scorers"),
        (["--scorers", "[{class_path: Proximty}]"], "did you mean Proximity?"),
    ],
)
def test_a_name_of_no_class_is_told_its_near_matches(mixer, words, said):
    write_table()
    code, _, err = mixer("associate", "--config", write_config(), "--out", "out", *words)
    assert code == 2
    assert said in err
    assert words[0].strip("-") in err


def test_a_name_of_two_classes_is_told_both(mixer):
    write_table()
    for module in ("one_depth", "other_depth"):  # classes stay: no other test has this name
        Path(f"{module}.py").write_text(
            "from mixer_torch import FunctionScorer\nclass Doubtful(FunctionScorer):\n    pass\n"
        )
    config = write_config(scorers=["one_depth.Doubtful", "other_depth.Doubtful", "Doubtful"])
    code, _, err = mixer("associate", "--config", config, "--out", "out")
    assert code == 2
    assert "one_depth.Doubtful" in err
    assert "other_depth.Doubtful" in err


def test_scorers_may_come_from_another_file(mixer, tmp_path):
    config = ROOT / "configs" / "pets.yaml"
    scorers = tmp_path / "scorers.yaml"
    scorers.write_text("scorers: [{class_path: Color}]")
    words = ["--config", config, "--config", scorers, "--out", "out", "--print_config"]
    code, out, err = mixer("associate", *words)
    assert code == 0, err
    found = yaml.safe_load(out)
    assert found["dataset"]["init_args"]["step"] == 20
    assert [scorer["class_path"] for scorer in found["scorers"]] == ["mixer_torch.scorers.Color"]


def test_the_command_itself_exits_with_2_and_draws_without_global_state(tmp_path, monkeypatch):
    script = (
        "import sys\nfrom mixer_torch.cli import main\n"
        "code = main()\nassert 'matplotlib.pyplot' not in sys.modules\nsys.exit(code)"
    )
    monkeypatch.chdir(tmp_path)
    write_table()
    write_config()

    def run(*argv):
        return subprocess.run(
            [sys.executable, "-c", script, *argv],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )

    good = run("associate", "--config", "config.yaml", "--out", "result")
    assert good.returncode == 0, good.stderr
    assert good.stderr == ""
    bad = run("associate", "--config", "config.yaml", "--out", "result", "--solvr.seed", "3")
    assert bad.returncode == 2
    assert "--solvr.seed" in bad.stderr
