"""mixer-train from the command line, on a table that it learns from in seconds."""

import csv
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import yaml
from safetensors.torch import load_file

from mixer_torch.cli import main as mixer
from mixer_torch.train.cli import main as mixer_train


def write_table(path, seed, objects=8, frames=10):
    generator = torch.Generator().manual_seed(seed)
    place = 2.5 * torch.randn(objects, 3, generator=generator)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "time", "x", "y", "z", "identity"])
        for frame in range(frames):
            seen = place + 0.6 * torch.randn(objects, 3, generator=generator)
            for k in range(objects):
                writer.writerow([frame, frame / 10, *seen[k].tolist(), k])


def table(path):
    return {"class_path": "mixer_torch.datasets.Table", "init_args": {"path": str(path)}}


@pytest.fixture
def config(tmp_path):
    for seed, part in enumerate(("train", "validate", "test")):
        write_table(tmp_path / f"{part}.csv", seed)
    settings = {
        "out": str(tmp_path / "run"),
        "model": {"class_path": "mixer_torch.train.CalibratorTraining"},
        "data": {
            "class_path": "mixer_torch.train.PairData",
            "init_args": {
                "scorers": [
                    {"class_path": "mixer_torch.scorers.Proximity", "init_args": {"scale": 0.4}},
                ],
                **{p: [table(tmp_path / f"{p}.csv")] for p in ("train", "validate", "test")},
                "batch_size": 256,
            },
        },
        "trainer": {"max_epochs": 6, "enable_progress_bar": False, "accelerator": "cpu"},
    }
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


def run(*words):
    assert mixer_train([str(word) for word in words]) == 0


def weights(folder):
    return torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True)["state_dict"]


def history(folder):
    rows = []
    for path in sorted(folder.glob("logs/version_*/metrics.csv")):
        with path.open() as file:
            rows += [row for row in csv.DictReader(file) if row.get("val/cllr")]
    return {int(row["epoch"]): float(row["val/cllr"]) for row in rows}


def test_fit_validate_test_and_associate(config, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before = {path.name for path in tmp_path.iterdir()}
    run("fit", "--config", config)
    out = tmp_path / "run"
    assert {path.name for path in tmp_path.iterdir()} - before == {"run"}
    run("validate", "--config", config)
    run("test", "--config", config)
    metrics = json.loads((out / "test" / "metrics.json").read_text())
    by_hand, trained = (metrics[k]["modalities"]["Proximity"] for k in ("by hand", "trained"))
    assert trained["cllr"] < by_hand["cllr"]
    assert trained["ece"] < by_hand["ece"]
    assert metrics["trained"]["f1"] >= metrics["by hand"]["f1"]
    for name in ("reliability.png", "histograms.png"):
        assert (out / "test" / name).read_bytes().startswith(b"\x89PNG")
    scene = tmp_path / "scene.yaml"
    scene.write_text(yaml.safe_dump({"dataset": table(tmp_path / "test.csv")}))
    scorers = out / "export" / "scorers.yaml"
    words = ["--config", scene, "--config", scorers, "--out", tmp_path / "found"]
    assert mixer(["associate", *map(str, words)]) == 0
    found = json.loads((tmp_path / "found" / "metrics.json").read_text())
    assert found["all"]["f1"] == pytest.approx(metrics["trained"]["f1"])


KILLER = """
import os, signal
from lightning.pytorch.callbacks import Callback

class Killer(Callback):
    def on_train_batch_end(self, trainer, module, outputs, batch, batch_idx):
        if trainer.current_epoch == 3 and batch_idx == 1:
            os.kill(os.getpid(), signal.SIGKILL)
"""


def test_killed_in_mid_epoch_it_ends_with_the_same_metrics(config, tmp_path):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    run("fit", "--config", config, "--out", whole)
    (tmp_path / "killer.py").write_text(KILLER)
    words = ["fit", "--config", config, "--out", broken, "--trainer.callbacks+=killer.Killer"]
    start = "import sys; from mixer_torch.train.cli import main; sys.exit(main())"
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])])
    threads = str(torch.get_num_threads())  # sums differ in the last bit with their number
    killed = subprocess.run(
        [sys.executable, "-c", start, *map(str, words)],
        env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": threads},
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr.decode()[-2000:]
    assert not (broken / "export").exists()
    run("fit", "--config", config, "--out", broken, "--ckpt_path", "last")
    for name, value in weights(whole).items():
        torch.testing.assert_close(weights(broken)[name], value, rtol=0, atol=0)
    assert {epoch: history(whole)[epoch] for epoch in (3, 4, 5)} == {
        epoch: history(broken)[epoch] for epoch in (3, 4, 5)
    }
    one, other = (load_file(d / "export" / "Proximity.safetensors") for d in (whole, broken))
    for name, value in one.items():
        torch.testing.assert_close(other[name], value, rtol=0, atol=0)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--data.init_args.train", "[]"], "expected at least one of each"),
        (["--model.init_args.learning_rate", "-1"], "learning_rate"),
        (["--data.init_args.pairs", "mixer_torch.Within"], "window"),
        (["--model.init_args.learning_rat", "1"], "learning_rat"),
        (
            [
                "--model.init_args.special",
                "{Sonar: {class_path: mixer_torch.scorers.Platt}}",
            ],
            "Sonar",
        ),
    ],
)
def test_mistakes_end_in_one_message_and_exit_code_2(config, words, message, capsys):
    try:
        code = mixer_train(["fit", "--config", str(config), *words])
    except SystemExit as stopped:
        code = stopped.code
    assert code == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


def test_testing_before_fitting_says_so(config, capsys):
    assert mixer_train(["test", "--config", str(config)]) == 2
    assert "run mixer-train fit first" in capsys.readouterr().err


def test_data_without_truth_says_so(config, tmp_path, capsys):
    lines = (tmp_path / "train.csv").read_text().splitlines()
    (tmp_path / "train.csv").write_text("\n".join(line.rsplit(",", 1)[0] for line in lines) + "\n")
    assert mixer_train(["fit", "--config", str(config)]) == 2
    assert "identity" in capsys.readouterr().err


ROOT = Path(__file__).parents[2]
CONFIGURATIONS = [
    *(ROOT / "configs" / "train").glob("*.yaml"),
    *(ROOT / "benchmarks" / "configs").glob("*/train_*.yaml"),
]


def test_there_is_one_configuration_a_task():
    names = {path.stem for path in CONFIGURATIONS if path.parent.name == "train"}
    assert names == {"calibrators", "fusion", "embedding"}


@pytest.mark.parametrize("path", sorted(CONFIGURATIONS), ids=lambda path: path.stem)
def test_configurations_of_the_project_are_valid(path, capsys):
    with pytest.raises(SystemExit) as ended:
        mixer_train(["fit", "--config", str(path), "--print_config"])
    assert ended.value.code == 0
    assert yaml.safe_load(capsys.readouterr().out)["out"].startswith("out/train")
