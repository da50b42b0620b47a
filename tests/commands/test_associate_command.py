"""`mixer associate`: what is written and said, for good input and bad."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_inputs import labels_in, names_in, one, write_config, write_sequence, write_table

from mixer_torch.cli import main

TABLES = {"associations.csv", "tracks.txt", "affinity.npz", "metrics.json", "config.yaml"}
PICTURES = {"affinity.png", "clusters.png", "frames.png"}


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


IMAGE_SCORERS = ["mixer_torch.scorers.IoU", "mixer_torch.scorers.Color", "mixer_torch.scorers.SIFT"]


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


@pytest.mark.parametrize("scorers", [["mixer_torch.scorers.IoU"], ["mixer_torch.scorers.Color"]])
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
        ({"scorers": ["mixer_torch.scorers.Proximity"]}, "Proximity needs 'position'"),
        ({"scorers": ["mixer_torch.scorers.Color"]}, "Color needs 'images'"),
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
