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
    assert [scorer["class_path"] for scorer in config["scorers"]] == [
        "mixer_torch.scorers.IoU", "mixer_torch.scorers.Proximity", "mixer_torch.scorers.Color", "mixer_torch.scorers.SIFT",
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["parking_lot", "pets", "cmu_hotel", "table"])
def test_configurations_of_the_project_are_valid(mixer, name):
    config = Path(__file__).parents[2] / "configs" / f"{name}.yaml"
    code, _, err = mixer("associate", "--config", config, "--out", "out", "--print_config")
    assert code == 0, err


def test_scorers_may_come_from_another_file(mixer, tmp_path):
    config = Path(__file__).parents[2] / "configs" / "pets_motion.yaml"
    scorers = tmp_path / "scorers.yaml"
    scorers.write_text("scorers: [{class_path: mixer_torch.scorers.Color}]")
    words = ["--config", config, "--config", scorers, "--out", "out", "--print_config"]
    code, out, err = mixer("associate", *words)
    assert code == 0, err
    assert yaml.safe_load(out)["dataset"]["init_args"]["window"] == 1


def test_importing_the_library_imports_nothing_heavy():
    code = (
        "import sys, mixer_torch, mixer_torch.cli\n"
        "heavy = {'lightning', 'pytorch_lightning', 'cv2', 'matplotlib', 'scorers', 'train'}\n"
        "heavy |= {'trackeval', 'supervision'}\n"
        "sys.exit(str(heavy & set(sys.modules)) if heavy & set(sys.modules) else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


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
