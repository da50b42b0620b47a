"""Covariates: numbers of pairs, their columns, and camera pairs, which are names."""

import pytest
import torch

import mixer_torch as mx
from mixer_torch.observations import Observations
from mixer_torch.scorers.calibrators import Fitted, MonotoneSpline, Platt, save_calibrator
from mixer_torch.scorers.covariates import COVARIATES, LEVELS, Covariates


def seen(camera):
    m = len(camera)
    box = torch.tensor([[0.0, 0.0, 10.0, 20.0], [0.0, 0.0, 10.0, 40.0]]).repeat(m, 1)[:m]
    return Observations(
        torch.arange(m),
        {
            "time": 2.0 * torch.arange(m).double(),
            "frame": torch.arange(m),
            "box": box,
            "confidence": torch.linspace(0.5, 0.9, m),
            "camera": torch.tensor(camera),
        },
    )


def test_values_by_hand():
    observations = seen([0, 1, 1])
    known = Covariates(list(COVARIATES))
    pairs = torch.tensor([[0, 1], [1, 2]])
    values = dict(zip(known.names, known.of(known.describe(observations), pairs).T, strict=True))
    log = torch.tensor([2.0, 3.0, 20.0]).double().log()
    expected = {
        "time_gap": [log[1], log[1]],
        "frame_gap": [log[0], log[0]],
        "box_size": [log[2], log[2]],
        "size_ratio": [log[0], log[0]],
        "confidence": [0.5, 0.7],
        "same_camera": [0.0, 1.0],
    }
    for name, value in expected.items():
        found = values[name]
        torch.testing.assert_close(found, torch.tensor(value).double(), rtol=1e-6, atol=1e-6)


def test_each_unordered_pair_of_cameras_has_a_number():
    cameras = [a for a in range(12) for _ in range(2)]
    observations = seen(cameras)
    pairs = mx.Every()(observations)
    known = Covariates(["camera_pair"])
    number = known.of(known.describe(observations), pairs)[:, 0].tolist()
    names = [tuple(sorted(cameras[k] for k in pair)) for pair in pairs.T.tolist()]
    assert len(set(zip(names, number, strict=True))) == len(set(names)) == len(set(number))
    swapped = known.of(known.describe(observations), pairs.flip(0))[:, 0].tolist()
    assert swapped == number


def test_columns_of_names():
    known = Covariates(["time_gap", "camera_pair"])
    values = torch.tensor([[1.0, 4.0], [2.0, 4.0], [3.0, 7.0], [2.0, torch.nan]]).double()
    known.learn(values)
    columns = known.columns(values)
    assert columns.shape == (4, known.width) == (4, 2 + LEVELS)
    assert columns[:, 2].tolist() == [1, 1, 0, 0]
    assert columns[:, 3].tolist() == [0, 0, 1, 0]
    assert not columns[:, 4:].any()
    new = torch.tensor([[2.0, 4.0], [2.0, 5.0], [2.0, torch.nan]]).double()
    assert known.support(new).tolist() == [1, 0, 1]


def by_camera(count=12_000, seed=0):
    """Evidence that speaks of one pair of cameras, less of another, and not of a third."""
    generator = torch.Generator().manual_seed(seed)
    code = torch.tensor([0.0, 4.0, 5.0])[torch.randint(3, (count,), generator=generator)].double()
    same = torch.rand(count, generator=generator) < 0.1
    way = torch.where(code == 0, 2.0, torch.where(code == 4, 1.0, 0.0)).double()
    x = torch.randn(count, generator=generator).double() + way * same
    return x, same, code[:, None]


@pytest.mark.parametrize("kind", [Platt, MonotoneSpline])
def test_evidence_is_worth_what_it_is_between_these_cameras(kind, tmp_path):
    x, same, code = by_camera()
    fitted = kind(covariates=["camera_pair"], regularisation=1e-6).fit(x, same, code)
    at = torch.tensor([0.0, 1.0, 2.0]).double()

    def ratio(pair):
        return fitted.log_ratio(at, torch.full((3, 1), pair).double()).detach()

    torch.testing.assert_close(ratio(0.0), 2 * at - 2, rtol=0.15, atol=0.4)
    torch.testing.assert_close(ratio(4.0), at - 0.5, rtol=0.15, atol=0.4)
    assert float(ratio(5.0).abs().max()) < 0.45
    assert ratio(9.0).tolist() == [0, 0, 0]
    save_calibrator(tmp_path / "by_camera.safetensors", fitted)
    again = Fitted(tmp_path / "by_camera.safetensors").fitted
    torch.testing.assert_close(again(x, code), fitted(x, code).detach(), rtol=0, atol=0)


def test_a_name_has_no_average():
    x, same, code = by_camera(4_000)
    fitted = Platt(covariates=["camera_pair"]).fit(x, same, code)
    unknown = torch.full_like(code, torch.nan)
    torch.testing.assert_close(fitted(x), fitted(x, unknown))
