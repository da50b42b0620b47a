"""The ablation of the tracker: what is taken out says nothing, and what rows become."""

import numpy as np
import pytest
from test_tracking_benchmark import folder  # noqa: F401

from mixer_torch.benchmarks import tracking, tracking_ablation
from mixer_torch.tracking import passes
from mixer_torch.tracking.evidence import FEATURES, FIRST_STAGE, MODALITIES
from mixer_torch.tracking.weights import Weights


@pytest.mark.parametrize("modality", FIRST_STAGE)
def test_a_modality_that_is_taken_out_says_the_same_of_every_pair(modality):
    weights = Weights.shipped()
    x = np.random.default_rng(0).normal(size=(20, len(FEATURES)))
    other = x.copy()
    own = np.isin(FEATURES, MODALITIES[modality])
    other[:, own] = np.random.default_rng(1).normal(size=(20, own.sum()))
    less = tracking_ablation.without_modality(weights, modality)["evidence"]
    np.testing.assert_allclose(less(x), less(other), rtol=1e-12)
    assert np.abs(weights["evidence"](x) - weights["evidence"](other)).max() > 0.01


def test_rows_and_table(folder, tmp_path):  # noqa: F811
    Weights.shipped().save(tmp_path / "without_two.safetensors")
    measure = passes.measure
    rows = list(tracking_ablation.run({"two": [tracking.Scene(folder)]}, tmp_path))
    assert passes.measure is measure
    names = ["nothing", *MODALITIES, *tracking_ablation.QUANTITIES]
    assert [row["without"] for row in rows] == names
    assert rows[0]["HOTA"] > 80
    rows[1] |= {"HOTA": rows[0]["HOTA"] - 2.0, "IDF1": rows[0]["IDF1"] + 1.0}
    lines = tracking_ablation.table(rows).splitlines()
    assert lines[2].startswith(f"| nothing | {rows[0]['HOTA']:.1f} / ")
    assert lines[3] == "| overlap | -2.0 / +1.0 |"
