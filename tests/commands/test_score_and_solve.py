"""`mixer score` and `mixer solve`, the steps of `mixer associate`."""

import json
from pathlib import Path

import yaml
from command_inputs import labels_in, write_config, write_table

from mixer_torch.association import Association


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
