import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from mixer_torch.association import Association
from mixer_torch.cli import main

TABLES = {"associations.csv", "tracks.txt", "affinity.npz", "metrics.json", "config.yaml"}
PICTURES = {"affinity.png", "clusters.png", "frames.png"}
OWN_SCORERS = '''
import torch
from mixer_torch import Calibrator, Scorer

class Depth(Scorer):
    """Alike in depth.

    Args:
        scale: Metres.
    """

    needs = ("depth",)

    def __init__(self, scale: float = 1.0) -> None:
        super().__init__()
        self.scale = scale

    def compare(self, description, pairs):
        return torch.exp(-(description[pairs[0]] - description[pairs[1]]).abs() / self.scale)

class Silent(Scorer):
    """Never has anything to say."""

    needs = ("depth",)

    def compare(self, description, pairs):
        return description[pairs[0]] * torch.nan

class Shouting(Depth):
    """Out of range."""

    def compare(self, description, pairs):
        return 1 + super().compare(description, pairs)

class Broken(Calibrator):
    """Gives NaN."""

    def forward(self, evidence):
        return evidence * torch.nan

class Undefined(Depth):
    """NaN after calibration."""

    def __init__(self) -> None:
        super().__init__()
        self.calibrator = Broken()
'''


@pytest.fixture
def mixer(tmp_path, monkeypatch, capsys):
    """Run the command in an empty folder: (exit code, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delenv("MIXER_TRACEBACK", raising=False)

    def run(*argv):
        try:
            code = main([str(word) for word in argv])
        except SystemExit as stop:
            code = stop.code
        out, err = capsys.readouterr()
        return code, out, err

    yield run
    sys.modules.pop("own_scorers", None)


def write_table(path="seen.csv", rows=None):
    """Three objects at depths 10, 20, 30, seen in three frames; or the rows given."""
    if rows is None:
        rows = [(f, k, 10 * (k + 1) + 0.1 * f) for f in range(3) for k in range(3)]
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("frame", "identity", "depth"))
        writer.writerows(rows)


def one(class_path, **init_args):
    """A class_path block."""
    return {"class_path": class_path, "init_args": init_args}


def write_config(path="config.yaml", scorers=("own_scorers.Depth",), **other):
    Path("own_scorers.py").write_text(OWN_SCORERS)
    config = {
        "dataset": one("mixer_torch.datasets.Table", path="seen.csv"),
        "scorers": [one(scorer) for scorer in scorers],
        **other,
    }
    Path(path).write_text(yaml.safe_dump(config))
    return path


def write_sequence(folder, detections, size=(64, 48), frames=3):
    """A MOTChallenge folder with noise for frames; detections are (frame, left)."""
    folder = Path(folder)
    for part in ("det", "img1"):
        (folder / part).mkdir(parents=True)
    (folder / "seqinfo.ini").write_text(
        f"[Sequence]\nname=tiny\nimDir=img1\nframeRate=5\nseqLength={frames}\n"
        f"imWidth={size[0]}\nimHeight={size[1]}\nimExt=.jpg\n"
    )
    (folder / "det" / "det.txt").write_text(
        "".join(f"{frame},-1,{left},10,16,24,0.9,-1,-1,-1\n" for frame, left in detections)
    )
    noise = np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    for frame in range(1, frames + 1):
        cv2.imwrite(str(folder / "img1" / f"{frame:06d}.jpg"), noise)
    return one("mixer_torch.datasets.MOTChallenge", path=str(folder))


def labels_in(path):
    with open(path, newline="") as file:
        return [int(row["label"]) for row in csv.DictReader(file)]


def names_in(folder):
    return {path.name for path in Path(folder).iterdir()}


def test_a_scorer_in_one_new_file_works_by_its_dotted_path(mixer):
    write_table()
    config = write_config(scorers=["own_scorers.Depth"])
    code, out, err = mixer("associate", "--config", config, "--out", "result", "--ablate")
    assert code == 0, err
    assert labels_in("result/associations.csv") == [0, 1, 2] * 3
    metrics = json.loads(Path("result/metrics.json").read_text())
    assert list(metrics) == ["all", "alone"]
    assert metrics["all"]["f1"] == 1
    assert metrics["alone"]["Depth"] == metrics["all"]
    assert "Depth" in out
    assert "clusters" in out
    assert "picture: result/affinity.png" in out
    assert err == ""
    assert names_in("result") == {*TABLES, "affinity.png"} - {"tracks.txt"}
    assert set(os.listdir()) - {"__pycache__"} == {"seen.csv", "own_scorers.py", config, "result"}


def test_running_the_saved_configuration_again_gives_the_same_answer(mixer):
    depth = np.random.default_rng(3).random(20)
    write_table(rows=[(i // 4, i % 4, value) for i, value in enumerate(depth)])
    config = write_config(scorers=["own_scorers.Depth", "own_scorers.Silent"])
    assert mixer("associate", "--config", config, "--out", "first", "--solver.seed", 5)[0] == 0
    assert mixer("associate", "--config", "first/config.yaml", "--out", "second")[0] == 0
    for name in ("associations.csv", "metrics.json"):
        assert Path("first", name).read_text() == Path("second", name).read_text()
    first, second = (
        yaml.safe_load(Path(d, "config.yaml").read_text()) for d in ("first", "second")
    )
    assert first.pop("out") == "first"
    assert second.pop("out") == "second"
    assert first == second
    assert first["solver"]["init_args"]["seed"] == 5


def test_print_config_is_a_config(mixer):
    write_table()
    config = write_config(ablate=True)
    code, printed, _ = mixer("associate", "--config", config, "--out", "result", "--print_config")
    assert code == 0
    assert not Path("result").exists()
    Path("printed.yaml").write_text(printed)
    assert mixer("associate", "--config", "printed.yaml")[0] == 0
    assert yaml.safe_load(Path("result/config.yaml").read_text()) == yaml.safe_load(printed)
    assert yaml.safe_load(printed)["scorers"][0]["init_args"] == {"scale": 1.0}


def test_modalities_are_named_and_their_weights_hold_when_each_is_alone(mixer):
    write_table()
    fusion = one("mixer_torch.LogOddsFusion", weights={"Depth": 2.0})
    config = write_config(scorers=["own_scorers.Silent", "own_scorers.Depth"], fusion=fusion)
    code, _, err = mixer("associate", "--config", config, "--out", "result", "--ablate", "true")
    assert code == 0, err
    alone = json.loads(Path("result/metrics.json").read_text())["alone"]
    assert list(alone) == ["Silent", "Depth"]
    assert alone["Silent"]["clusters"] == 9
    assert alone["Depth"]["clusters"] == 3


def test_scores_that_say_nothing_make_singletons(mixer):
    write_table()
    config = write_config(scorers=["own_scorers.Silent"])
    code, out, _ = mixer("associate", "--config", config, "--out", "result")
    assert code == 0
    assert labels_in("result/associations.csv") == list(range(9))
    assert "objective 0" in out


def test_without_a_truth_there_are_clusters_and_no_metrics(mixer):
    write_table(rows=[(0, -1, 1.0), (1, -1, 1.1), (1, -1, 9.0)])
    code, out, _ = mixer("associate", "--config", write_config(), "--out", "result")
    assert code == 0
    assert "all  2 clusters" in out
    assert "metrics.json" not in names_in("result")


def test_one_observation(mixer):
    write_table(rows=[(7, 0, 1.0)])
    code, _, err = mixer("associate", "--config", write_config(), "--out", "result", "--ablate")
    assert code == 0, err
    assert labels_in("result/associations.csv") == [0]
    assert json.loads(Path("result/metrics.json").read_text())["all"]["clusters"] == 1


IMAGE_SCORERS = ["scorers.IoU", "scorers.Color", "scorers.SIFT"]


def test_an_empty_detection_file_gives_a_result_of_nothing(mixer):
    config = write_config(scorers=IMAGE_SCORERS, dataset=write_sequence("tiny", []))
    code, out, err = mixer("associate", "--config", config, "--out", "result")
    assert code == 0, err
    assert "0 observations" in out
    assert labels_in("result/associations.csv") == []
    assert Path("result/tracks.txt").read_text() == ""


def test_a_view_without_detections_is_no_obstacle(mixer):
    dataset = write_sequence("tiny", [(1, 4), (1, 40), (3, 5)])
    config = write_config(scorers=IMAGE_SCORERS, dataset=dataset, video=True)
    code, out, err = mixer("associate", "--config", config, "--out", "result")
    assert code == 0, err
    assert "3 observations in 2 views" in out
    assert names_in("result") == {*TABLES, *PICTURES, "tracks.mp4"} - {"metrics.json"}
    tracks = [line.split(",") for line in Path("result/tracks.txt").read_text().splitlines()]
    assert [track[0] for track in tracks] == ["1", "1", "3"]


@pytest.mark.parametrize("scorers", [["scorers.IoU"], ["scorers.Color"]])
def test_a_frame_that_does_not_decode_is_named_and_leaves_nothing(mixer, scorers):
    dataset = write_sequence("tiny", [(1, 4), (2, 5)])
    broken = Path("tiny/img1/000002.jpg")
    broken.write_bytes(b"not an image")
    config = write_config(scorers=scorers, dataset=dataset)
    code, out, err = mixer("associate", "--config", config, "--out", "here/result")
    assert (code, out) == (2, "")
    assert str(broken) in err
    assert "does not decode" in err
    assert not Path("here/result").exists()
    assert list(Path(".").glob("**/.result*")) == []


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"scorer": []}, "scorer"),
        ({"dataset": one("mixer_torch.datasets.Table", pth="x")}, "pth"),
        ({"solver": one("mixer_torch.Mixer", sede=1)}, "sede"),
        ({"solver": one("mixer_torch.Mixture")}, "Mixture"),
        ({"scorers": ["own_scorers.Deep"]}, "Deep"),
        ({"scorers": ["no_such_scorers.Deep"]}, "no_such_scorers"),
        ({"solver": one("own_scorers.Depth")}, "own_scorers.Depth"),
        ({"ablate": "perhaps"}, "perhaps"),
        ({"scorers": []}, "scorers"),
        ({"scorers": ["own_scorers.Shouting"]}, "Shouting: expected scores in [0, 1]"),
        ({"scorers": ["own_scorers.Undefined"]}, "Undefined: expected scores in [0, 1], got nan"),
        ({"scorers": ["scorers.Proximity"]}, "Proximity needs 'position'"),
        ({"scorers": ["scorers.Color"]}, "Color needs 'images'"),
        ({"dataset": one("mixer_torch.datasets.Table", path="no.csv")}, "no.csv"),
        ({"fusion": one("mixer_torch.LinearFusion", weights={"Dept": 1})}, "'Dept'"),
        ({"fusion": one("mixer_torch.LinearFusion", weights={"Depth": -1})}, "weights['Depth']"),
        ({"device": "abacus"}, "abacus"),
        ({"device": "cuda:99"}, "cuda:99"),
        ({"out": "seen.csv"}, "seen.csv"),
    ],
)
def test_mistakes_are_named_with_exit_code_2_and_no_traceback(mixer, change, named):
    write_table()
    config = write_config(**{"out": "result", **change})
    code, out, err = mixer("associate", "--config", config)
    assert code == 2
    assert named in err
    assert "Traceback" not in err
    assert out == ""
    assert not Path("result").exists()


def test_a_missing_column_is_named(mixer):
    Path("seen.csv").write_text("depth\n1.0\n")
    code, _, err = mixer("associate", "--config", write_config(), "--out", "result")
    assert code == 2
    assert "seen.csv" in err
    assert "frame" in err


def test_a_missing_configuration_is_named(mixer):
    code, _, err = mixer("associate", "--config", "none.yaml", "--out", "result")
    assert code == 2
    assert "none.yaml" in err


def test_faults_of_the_program_are_not_hidden(mixer, monkeypatch):
    write_table()

    def broken(*_, **__):
        raise RuntimeError("a bug")

    monkeypatch.setattr("mixer_torch.commands.associate.solve_affinity", broken)
    with pytest.raises(RuntimeError, match="a bug"):
        main(["associate", "--config", write_config(), "--out", "result"])


def test_a_traceback_is_there_for_who_asks(mixer, monkeypatch):
    write_table()
    monkeypatch.setenv("MIXER_TRACEBACK", "1")
    config = write_config(scorers=["own_scorers.Shouting"])
    with pytest.raises(ValueError, match="Shouting"):
        main(["associate", "--config", config, "--out", "result"])


def test_score_solve_and_evaluate_are_the_steps_of_associate(mixer):
    write_table()
    config = write_config(ablate=True, fusion={"class_path": "mixer_torch.LogOddsFusion"})
    assert mixer("associate", "--config", config, "--out", "result")[0] == 0
    assert mixer("score", "--config", config, "--out", "step/affinity.npz")[0] == 0
    steps = ("solve", "step/affinity.npz", "--config", config)
    code, out, err = mixer(*steps, "--out", "step/labels.csv")
    assert code == 0, err
    assert "3 clusters" in out
    assert labels_in("step/labels.csv") == labels_in("result/associations.csv")
    assert mixer(*steps, "--out", "step/association.npz")[0] == 0
    assert Association.load("step/association.npz").num_clusters == 3
    expected = json.loads(Path("result/metrics.json").read_text())["all"]
    for result in ("result/associations.csv", "step/labels.csv", "step/association.npz"):
        code, out, err = mixer(
            "evaluate", "--result", result, "--config", config, "--out", "m.json"
        )
        assert code == 0, err
        assert json.loads(Path("m.json").read_text()) == {"all": expected}
    assert "adjusted rand" in out
    solved = yaml.safe_load(Path("step/association.yaml").read_text())
    assert solved["affinity"] == "step/affinity.npz"


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
    for path in ("scorers.IoU", "mixer_torch.Mixer", "mixer_torch.datasets.Table"):
        assert lines[path][0], path
    assert "does not load" not in out


@pytest.mark.parametrize("command", ["demo", "associate", "score", "solve", "evaluate", "list"])
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
        "scorers.IoU", "scorers.Proximity", "scorers.Color", "scorers.SIFT",
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["parking_lot", "pets", "cmu_hotel", "table"])
def test_configurations_of_the_project_are_valid(mixer, name):
    config = Path(__file__).parents[1] / "configs" / f"{name}.yaml"
    code, _, err = mixer("associate", "--config", config, "--out", "out", "--print_config")
    assert code == 0, err


def test_importing_the_library_imports_nothing_heavy():
    code = (
        "import sys, mixer_torch, mixer_torch.cli\n"
        "heavy = {'lightning', 'pytorch_lightning', 'cv2', 'matplotlib', 'scorers', 'train'}\n"
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
