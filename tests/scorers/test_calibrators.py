"""Fitted calibrators against what is known in closed form, and their safeguards."""

import math

import numpy as np
import pytest
import torch

import mixer_torch as mx
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.observations import Observations
from mixer_torch.scorers.calibrators import (
    Fitted,
    Isotonic,
    MonotoneSpline,
    Platt,
    load_calibrator,
    save_calibrator,
)

KINDS = [Platt, Isotonic, MonotoneSpline]


def rare_matches(count=20_000, rate=0.03, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, generator=generator) < rate, generator


def gaussian_evidence(separation=1.5, **arguments):
    """Evidence whose log likelihood ratio is known: separation * (x - separation / 2)."""
    same, generator = rare_matches(**arguments)
    x = torch.randn(len(same), generator=generator, dtype=torch.float64) + separation * same
    return x, same


@pytest.mark.parametrize(
    ("kind", "tolerance"),
    [(Platt, 0.2), (Isotonic, 0.6), (MonotoneSpline, 0.35)],
)
def test_log_ratio_is_that_of_the_densities_at_any_base_rate(kind, tolerance):
    at = torch.tensor([-0.5, 0.0, 0.75, 1.5, 2.0], dtype=torch.float64)
    true = 1.5 * (at - 0.75)
    for rate in (0.02, 0.3):
        x, same = gaussian_evidence(rate=rate, count=40_000)
        found = kind().fit(x, same).log_ratio(at).detach()
        assert float((found - true).abs().max()) < tolerance


def test_platt_is_logistic_regression():
    from sklearn.linear_model import LogisticRegression

    x, same = gaussian_evidence(count=4_000, rate=0.1)
    kind = Platt(regularisation=1e-12).fit(x, same)
    peer = LogisticRegression(C=np.inf).fit(x[:, None].numpy(), same.numpy())
    at = torch.linspace(-1, 3, 9, dtype=torch.float64)
    logit = torch.from_numpy(peer.decision_function(at[:, None].numpy()))
    prior = torch.logit(same.double().mean())
    torch.testing.assert_close(kind.log_ratio(at), logit - prior, rtol=1e-3, atol=2e-3)


def test_isotonic_pools_are_those_of_scikit_learn():
    from sklearn.isotonic import IsotonicRegression

    x, same = gaussian_evidence(count=3_000, rate=0.2)
    kind = Isotonic()
    kind.learn_statistics(x, same)
    peer = IsotonicRegression().fit(x.numpy(), same.double().numpy())
    steps = np.unique(np.diff(np.flatnonzero(np.diff(peer.predict(np.sort(x.numpy()))))))
    assert len(steps) > 1
    assert set(kind.knots.tolist()) <= set(x.tolist())
    pools = len(np.unique(peer.predict(x.numpy())))
    assert len(torch.unique(kind.values)) <= pools


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_noise_says_nothing(kind, seed):
    same, generator = rare_matches(seed=seed)
    noise = torch.rand(len(same), generator=generator)
    scores = kind().fit(noise, same)(torch.linspace(-1, 2, 50))
    assert bool((scores == 0.5).all())


@pytest.mark.parametrize("kind", KINDS)
def test_before_fitting_nothing_is_said(kind):
    assert kind()(torch.linspace(0, 1, 7)).tolist() == [0.5] * 7


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sign", [1, -1])
def test_monotone_within_what_training_saw(kind, sign):
    x, same = gaussian_evidence(count=5_000, rate=0.1)
    x = sign * x
    scores = kind().fit(x, same)(torch.linspace(float(x.min()), float(x.max()), 200)).detach()
    assert bool((sign * scores.diff() >= -1e-7).all())
    assert sign * float(scores[-1] - scores[0]) > 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_never_sure_and_silent_beyond_training(kind):
    generator = torch.Generator().manual_seed(0)
    same = torch.arange(400) < 40
    x = torch.where(same, 4.0, -4.0) + 0.1 * torch.randn(400, generator=generator)
    fitted = kind().fit(x, same)
    ratio = fitted.log_ratio(x).detach()
    assert float(ratio.max()) <= math.log(361) + 1e-6
    assert float(ratio.min()) >= -math.log(41) - 1e-6
    assert float(ratio[same].mean()) > 1
    far = fitted(torch.tensor([-1e6, 1e6, 3e38])).detach()
    torch.testing.assert_close(far, torch.full((3,), 0.5))


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_of_the_log_ratio(kind):
    x, same = gaussian_evidence(count=3_000, rate=0.1)
    fitted = kind().fit(x, same)
    at = torch.tensor([0.13, 0.41, 1.2], dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(fitted.log_ratio, (at,))


def test_covariates_change_what_evidence_is_worth_and_are_none_themselves():
    """Evidence speaks where c = 0 only, and matches are ten times as frequent where c = 1."""
    generator = torch.Generator().manual_seed(0)
    c = (torch.rand(40_000, generator=generator) < 0.5).double()
    same = torch.rand(40_000, generator=generator) < torch.where(c == 1, 0.2, 0.02)
    x = torch.randn(40_000, generator=generator).double() + 2 * same * (1 - c)
    fitted = Platt(["time_gap"], regularisation=1e-6).fit(x, same, c[:, None])
    at = torch.tensor([-1.0, 1.0, 3.0], dtype=torch.float64)
    zero, one = torch.zeros(3, 1), torch.ones(3, 1)
    torch.testing.assert_close(fitted.log_ratio(at, zero), 2 * at - 2, rtol=0.1, atol=0.3)
    assert float(fitted.log_ratio(at, one).detach().abs().max()) < 0.3


@pytest.mark.parametrize("kind", KINDS)
def test_covariates_alone_say_nothing(kind):
    generator = torch.Generator().manual_seed(1)
    c = torch.rand(8_000, 1, generator=generator).double() * 3
    same = torch.rand(8_000, generator=generator) < 0.15 * torch.exp(-c[:, 0])
    noise = torch.rand(8_000, generator=generator).double()
    fitted = kind(covariates=["time_gap"]).fit(noise, same, c)
    assert bool((fitted(noise, c) == 0.5).all())


def test_missing_evidence_is_left_out_of_fitting_and_says_nothing():
    x, same = gaussian_evidence(count=2_000, rate=0.1)
    holes = x.clone()
    holes[::3] = torch.nan
    keep = holes.isfinite()
    there, here = Platt().fit(holes, same), Platt().fit(x[keep], same[keep])
    assert there.slope.item() == here.slope.item()
    scorer = mx.FunctionScorer(lambda a, b: (a - b).abs(), "depth", there)
    seen = Observations(torch.arange(3), {"depth": torch.tensor([0.0, torch.nan, 1.0])})
    assert scorer(seen, mx.Every()(seen))[[0, 2]].tolist() == [0.5, 0.5]


@pytest.mark.parametrize("kind", KINDS)
def test_saved_and_loaded_in_a_scorer(kind, tmp_path):
    generator = torch.Generator().manual_seed(2)
    x, same = gaussian_evidence(count=3_000, rate=0.1)
    c = torch.rand(3_000, 2, generator=generator).double()
    fitted = kind(covariates=["time_gap", "confidence"])
    fitted.learn_statistics(x, same, c)
    path = tmp_path / "depth.safetensors"
    settings = {"class_path": "mixer_torch.scorers.Proximity", "init_args": {"scale": 2.0}}
    save_calibrator(path, fitted, settings)
    assert [file.name for file in tmp_path.iterdir()] == ["depth.safetensors"]
    loaded, scorer = load_calibrator(path)
    assert scorer == settings
    torch.testing.assert_close(loaded(x, c), fitted(x, c), rtol=0, atol=0)
    seen = Observations(
        torch.arange(4),
        {
            "depth": torch.rand(4, generator=generator),
            "time": torch.arange(4).double(),
            "confidence": torch.rand(4, generator=generator),
        },
    )
    pairs = mx.Every()(seen)
    scorer = mx.FunctionScorer(lambda a, b: (a - b).abs(), "depth", Fitted(path))
    scores = scorer(seen, pairs)
    covariates = fitted.covariates.of(fitted.describe(seen), pairs)
    distance = (seen["depth"][pairs[0]] - seen["depth"][pairs[1]]).abs()
    torch.testing.assert_close(scores, fitted(distance, covariates))
    torch.testing.assert_close(mx.score(seen, [scorer]).scores[0], scores)
    with pytest.raises(KeyError, match=r"calibrator of .* needs 'time'"):
        scorer(Observations(seen.view, {"depth": seen["depth"]}), pairs)


def test_files_that_are_something_else(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        Fitted(tmp_path / "nowhere.safetensors")
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"not that")
    with pytest.raises(ValueError, match="broken"):
        Fitted(broken)
    from safetensors.torch import save_file

    other = tmp_path / "other.safetensors"
    save_file({"weight": torch.zeros(1)}, other)
    with pytest.raises(ValueError, match="expected a file of kind"):
        Fitted(other)
    save_file(
        {"weight": torch.zeros(1)},
        other,
        {"format": "mixer-torch calibrator 2", "class_path": "os.system", "init_args": "{}"},
    )
    with pytest.raises(ValueError, match=r"no calibrator 'os\.system' is imported"):
        Fitted(other)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Platt(["weather"]), "covariates"),
        (lambda: Platt(regularisation=0.0), "regularisation"),
        (lambda: MonotoneSpline(1), "knots"),
        (lambda: Platt().fit(torch.zeros(3), torch.ones(3)), "both kinds"),
        (lambda: Platt().fit(torch.zeros(3), torch.ones(2)), "same"),
        (lambda: Platt(["time_gap"]).fit(torch.arange(4.0), torch.arange(4) > 1), "covariates"),
        (
            lambda: Platt().fit(torch.arange(4.0), torch.arange(4) > 1, groups=torch.zeros(4)),
            "groups: expected two",
        ),
    ],
)
def test_bad_arguments_are_named(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_noise_beside_other_modalities_does_not_lower_f1():
    """The definition: LR 1 is 0.5, and 0.5 changes nothing."""
    generator = torch.Generator().manual_seed(5)
    identity = torch.arange(60) % 6
    view = torch.arange(60) // 6
    place = torch.randn(6, 3, generator=generator)[identity]
    seen = Observations(
        view,
        {
            "position": place + 0.25 * torch.randn(60, 3, generator=generator),
            "noise": torch.rand(60, generator=generator),
            "identity": identity,
        },
    )
    pairs = mx.Every()(seen)
    same = identity[pairs[0]] == identity[pairs[1]]

    def distance(a, b):
        return (a - b).square().sum(1)

    def chance(a, b):
        return torch.frac(1000 * (a + b))

    near = mx.FunctionScorer(distance, "position")
    near.calibrator = MonotoneSpline().fit(near.evidence(seen, pairs), same)
    noise = mx.FunctionScorer(chance, "noise")
    noise.calibrator = MonotoneSpline().fit(noise.evidence(seen, pairs), same)
    assert bool((noise(seen, pairs) == 0.5).all())
    alone, both = (
        evaluate(mx.associate(seen, scorers), identity, view)["f1"]
        for scorers in ([near], [near, noise])
    )
    assert alone > 0.5
    assert both == alone


def test_covariates_as_evidence():
    generator = torch.Generator().manual_seed(1)
    c = torch.rand(8_000, 1, generator=generator).double() * 3
    same = torch.rand(8_000, generator=generator) < 0.15 * torch.exp(-c[:, 0])
    noise = torch.rand(8_000, generator=generator).double()
    fitted = Platt(["time_gap"], covariates_as_evidence=True).fit(noise, same, c)
    ratio = fitted.log_ratio(noise[:4], torch.tensor([[0.2], [1.0], [2.0], [2.8]])).detach()
    mean = -same.double().mean().logit()
    true = torch.logit(0.15 * torch.exp(-torch.tensor([0.2, 1.0, 2.0, 2.8]).double())) + mean
    torch.testing.assert_close(ratio, true, rtol=0.2, atol=0.25)
