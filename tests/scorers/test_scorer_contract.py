"""What every scorer promises; the subjects are found, so a new file in scorers/ is tested too."""

import importlib
import inspect
import pkgutil

import numpy as np
import pytest
import torch

from mixer_torch import scorers
from mixer_torch.observations import Images, Observations
from mixer_torch.pairs import Every
from mixer_torch.scorers import SIFT, Color, IoU, Proximity, SIFTAtPoints
from mixer_torch.scorers.curves import Logistic
from mixer_torch.scoring import Calibrated, Calibrator, FunctionScorer, Scorer


def scorer_classes():
    for module in pkgutil.iter_modules(scorers.__path__):
        namespace = vars(importlib.import_module(f"mixer_torch.scorers.{module.name}"))
        for value in namespace.values():
            if inspect.isclass(value) and issubclass(value, Scorer) and value is not Scorer:
                yield value


def cosine(a, b):
    return torch.nn.functional.cosine_similarity(a, b)


CLASSES = sorted(set(scorer_classes()), key=lambda cls: cls.__name__)
SUBJECTS = {cls.__name__: cls for cls in CLASSES} | {
    "IoU in seconds": lambda: IoU(0.5, feature="time"),
    "Proximity of what moves": lambda: Proximity(scale=0.5, memory=5.0, speed=1.5),
    "Proximity of what keeps its velocity": lambda: Proximity(0.5, 5.0, 0.1, swerve=0.3),
    "Color histogram": lambda: Color("histogram"),
    "SIFT at points": SIFTAtPoints,
    "FunctionScorer": lambda: FunctionScorer(cosine, "embedding", Logistic(4.0, 0.2)),
    "Calibrated": lambda: Calibrated(Proximity(), Logistic(3.0, 0.5)),
}


@pytest.fixture(params=SUBJECTS)
def scorer(request):
    return SUBJECTS[request.param]()


def pictures(count, seed=0):
    """Frames of noise smoothed at several scales, so that there are keypoints and colours."""
    import cv2

    generator = np.random.default_rng(seed)
    frames = []
    for _ in range(count):
        image = np.zeros((120, 160, 3))
        for scale in (4, 10, 30):
            noise = generator.normal(size=(120 // scale + 2, 160 // scale + 2, 3))
            image += cv2.resize(noise, (160, 120), interpolation=cv2.INTER_CUBIC)
        frames.append((127 + 60 * image).clip(0, 255).astype(np.uint8))
    return frames


def observations(m=9, seed=0):
    """m things in three views of one camera, with every standard feature and pixels."""
    generator = torch.Generator().manual_seed(seed)
    view = torch.arange(m) // 3
    corner = torch.rand(m, 2, generator=generator) * 60
    size = 30 + 20 * torch.rand(m, 2, generator=generator)
    box = torch.cat([corner, corner + size], 1)
    features = {
        "time": view.double() / 2,
        "frame": view,
        "camera": torch.zeros(m, dtype=torch.int64),
        "box": box,
        "position": torch.randn(m, 3, generator=generator),
        "confidence": torch.rand(m, generator=generator),
        "embedding": torch.randn(m, 8, generator=generator),
        "identity": torch.arange(m) % 3,
        "point": corner + size / 2,
        "velocity": torch.randn(m, 3, generator=generator),
    }
    images = Images(pictures(max(int(view.max()) + 1 if m else 1, 1)), view.numpy(), box.numpy())
    return Observations(view, features, images)


def scores(scorer, seen, pairs=None):
    with torch.no_grad():
        return scorer(seen, Every()(seen) if pairs is None else pairs)


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_constructor_has_defaults_and_takes_a_calibrator_last(cls):
    parameters = list(inspect.signature(cls.__init__).parameters.values())[1:]
    assert all(parameter.default is not parameter.empty for parameter in parameters)
    assert parameters[-1].name == "calibrator"
    assert parameters[-1].default is None


@pytest.mark.parametrize("m", [0, 1])
def test_nothing_to_compare(scorer, m):
    result = scores(scorer, observations(m))
    assert result.shape == (0,)
    assert result.is_floating_point()


def test_scores_are_in_range_one_a_pair(scorer):
    seen = observations()
    result = scores(scorer, seen)
    assert result.shape == (Every()(seen).shape[1],)
    assert bool(((result >= 0) & (result <= 1)).all())
    assert result.device == seen.device


def test_order_of_observations_is_no_matter(scorer):
    # A permutation reverses the roles within about half of the pairs, so this is symmetry as well.
    seen = observations()
    order = torch.randperm(len(seen), generator=torch.Generator().manual_seed(3))
    pairs = Every()(seen)
    place = torch.argsort(order)
    moved = place[pairs].sort(dim=0).values
    assert bool((place[pairs][0] > place[pairs][1]).any())
    there = scores(scorer, seen.select(order), moved)
    torch.testing.assert_close(there, scores(scorer, seen), rtol=1e-4, atol=1e-5)


def test_what_is_not_measured_has_nothing_to_say(scorer):
    seen = observations()
    floats = [key for key in scorer.needs if key != "images" and seen[key].is_floating_point()]
    if not floats:
        pytest.skip("it reads no feature that could be missing in a row")
    for key in floats:
        value = seen[key].clone()
        value[4] = torch.nan
        pairs = Every()(seen)
        result = scores(scorer, seen.with_features(**{key: value}), pairs)
        assert bool((result[(pairs == 4).any(0)] == 0.5).all())
        assert bool(result.isfinite().all())


def test_degenerate_rows_stay_in_range(scorer):
    seen = observations()
    box = seen["box"].clone()
    box[1, 2:] = box[1, :2]
    same = {key: seen[key].clone() for key in ("position", "embedding", "point")}
    for value in same.values():
        value[5] = value[1]
    same["embedding"][2] = 0
    frames = pictures(3)
    frames[2][:] = 77
    images = Images(frames, seen.view.numpy(), box.numpy())
    odd = Observations(seen.view, {**seen.features, **same, "box": box}, images)
    result = scores(scorer, odd)
    assert bool(((result >= 0) & (result <= 1)).all())


def test_all_alike_stays_in_range(scorer):
    seen = observations(6).select(torch.zeros(6, dtype=torch.int64))
    seen = Observations(torch.arange(6), seen.features, seen.images)
    result = scores(scorer, seen)
    assert bool(((result >= 0) & (result <= 1)).all())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype_of_features_decides_the_work(scorer, dtype):
    seen = observations()
    fixed = {"time", "box", "position"}
    cast = {
        key: value.to(dtype)
        for key, value in seen.features.items()
        if value.is_floating_point() and key not in fixed
    }
    result = scores(scorer, seen.with_features(**cast))
    torch.testing.assert_close(result.float(), scores(scorer, seen).float(), rtol=1e-4, atol=1e-5)


@pytest.mark.cuda
def test_device_of_the_observations_is_that_of_the_scores(scorer):
    if isinstance(scorer, SIFT):
        pytest.importorskip("kornia")
    seen = observations().to("cuda")
    result = scores(scorer, seen)
    assert result.device.type == "cuda"
    torch.testing.assert_close(result.cpu(), scores(scorer, observations()), rtol=1e-3, atol=1e-3)


def test_gradients_are_finite(scorer):
    seen = observations()
    leaves = {
        key: seen[key].clone().requires_grad_()
        for key in scorer.needs
        if key not in ("images", "time") and seen[key].is_floating_point()
    }
    for value in leaves.values():
        value.data[5] = value.data[1]
    result = scorer(seen.with_features(**leaves), Every()(seen))
    if not result.requires_grad:
        pytest.skip("it reads nothing that a gradient could reach")
    result.sum().backward()
    for value in leaves.values():
        assert bool(value.grad.isfinite().all())
        assert float(value.grad.abs().sum()) > 0


def test_chunks_do_not_change_the_result(scorer):
    seen = observations()
    whole = scores(scorer, seen)
    scorer.chunk = 4
    torch.testing.assert_close(scores(scorer, seen), whole, rtol=1e-6, atol=1e-6)


def test_inputs_are_not_written_to(scorer):
    seen = observations()
    before = {key: value.clone() for key, value in seen.features.items()}
    frames = [frame.copy() for frame in seen.images.frames]
    scores(scorer, seen)
    for key, value in before.items():
        torch.testing.assert_close(seen[key], value, rtol=0, atol=0)
    for now, then in zip(seen.images.frames, frames, strict=True):
        np.testing.assert_array_equal(now, then)


def test_another_calibrator_takes_its_place(scorer):
    class Sure(Calibrator):
        def forward(self, evidence):
            return torch.full_like(evidence, 0.75)

    scorer.calibrator = Sure()
    result = scores(scorer, observations())
    assert set(result.tolist()) <= {0.5, 0.75}
    assert 0.75 in result


def test_missing_feature_is_named(scorer):
    bare = Observations(torch.arange(3))
    with pytest.raises(KeyError, match=scorer.needs[0]):
        scores(scorer, bare)


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_forward_is_not_for_overriding(cls):
    with pytest.raises(TypeError, match="define describe and compare"):
        type("Wilful", (cls,), {"forward": lambda self, observations, pairs: pairs})
