"""Metrics of calibration against scikit-learn and figures worked by hand."""

import math

import numpy as np
import pytest
import torch

from mixer_torch.metrics.calibration import (
    area_under_roc,
    brier,
    calibration_metrics,
    cllr,
    expected_calibration_error,
    min_cllr,
    reliability,
    roc,
)


@pytest.fixture
def pairs():
    generator = torch.Generator().manual_seed(0)
    same = torch.rand(2_000, generator=generator) < 0.2
    ratio = torch.randn(2_000, generator=generator, dtype=torch.float64) + 2.0 * same - 1
    return (2 * ratio).round(decimals=1), same


def test_saying_nothing():
    same = torch.tensor([True, False, False])
    metrics = calibration_metrics(torch.zeros(3), same)
    assert metrics == {
        "cllr": pytest.approx(1.0),
        "min_cllr": pytest.approx(1.0),
        "log_loss": pytest.approx(math.log(2)),
        "brier": pytest.approx(0.25),
        "ece": pytest.approx(0.0),
        "auc": pytest.approx(0.5),
    }


def test_by_hand():
    ratio = torch.tensor([math.log(3), -math.log(3), -math.log(3)]).double()
    same = torch.tensor([True, True, False])
    # Same: log2(4/3) and log2(4); different: log2(4/3).
    assert cllr(ratio, same) == pytest.approx((math.log2(4 / 3) + 2) / 4 + math.log2(4 / 3) / 2)
    assert brier(ratio, same) == pytest.approx(((0.0625 + 0.5625) / 2 + 0.0625) / 2)
    # Bins of 0.25 and 0.75: a third of the weight at 0.25 is same, all of that at 0.75.
    assert expected_calibration_error(ratio, same) == pytest.approx(
        0.75 * abs(1 / 3 - 0.25) + 0.25 * 0.25
    )


def test_against_scikit_learn(pairs):
    from sklearn.metrics import brier_score_loss, log_loss, roc_auc_score

    ratio, same = pairs
    truth, score = same.numpy(), torch.sigmoid(ratio).numpy()
    weight = np.where(truth, 0.5 / truth.sum(), 0.5 / (~truth).sum())
    expected = log_loss(truth, score, sample_weight=weight)
    metrics = calibration_metrics(ratio, same)
    assert metrics["log_loss"] == pytest.approx(expected)
    assert metrics["cllr"] == pytest.approx(expected / math.log(2))
    assert metrics["brier"] == pytest.approx(brier_score_loss(truth, score, sample_weight=weight))
    assert metrics["auc"] == pytest.approx(roc_auc_score(truth, score))


def test_min_cllr_is_the_least_that_any_monotone_map_reaches(pairs):
    ratio, same = pairs
    least = min_cllr(ratio, same)
    for slope in (0.2, 0.5, 1.0, 2.0):
        for shift in (-1.0, 0.0, 1.0):
            assert least <= cllr(slope * ratio + shift, same) + 1e-9
    assert min_cllr(ratio.exp(), same) == pytest.approx(least)
    assert min_cllr(same.double(), same) == pytest.approx(0.0, abs=1e-9)
    assert min_cllr(-same.double(), same) == pytest.approx(1.0)


def test_roc_rises_from_corner_to_corner(pairs):
    false, true = roc(*pairs)
    assert (float(false[0]), float(true[0])) == (0.0, 0.0)
    assert (float(false[-1]), float(true[-1])) == (1.0, 1.0)
    assert bool((false.diff() >= 0).all())
    assert bool((true.diff() >= 0).all())
    assert area_under_roc(*pairs) > 0.8


def test_reliability_weighs_both_kinds_alike(pairs):
    table = reliability(*pairs)
    assert float(table["weight"].sum()) == pytest.approx(1.0)
    assert float((table["weight"] * table["share"]).sum()) == pytest.approx(0.5)
    assert int(table["count"].sum()) == len(pairs[1])


@pytest.mark.parametrize(
    ("ratio", "same", "match"),
    [
        ([0.0, 1.0], [True], "same"),
        ([0.0, math.inf], [True, False], "log_ratio"),
        ([0.0, 1.0], [True, True], "both kinds"),
    ],
)
def test_bad_input_is_named(ratio, same, match):
    with pytest.raises(ValueError, match=match):
        calibration_metrics(torch.tensor(ratio), torch.tensor(same))
