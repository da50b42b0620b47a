"""Crowds: frequencies of the model, and what holds for every draw."""

import numpy as np
import pytest
import torch

from mixer_torch.datasets.crowd import HEIGHT, WIDTH, Crowd, visible_share
from mixer_torch.plugins import KINDS, members


def boxes(observations):
    return observations["box"].double().numpy()


def keyed(observations):
    """Boxes by frame and identity."""
    keys = zip(observations["frame"].tolist(), observations["identity"].tolist(), strict=True)
    return dict(zip(keys, boxes(observations), strict=True))


def test_listed():
    (kind,) = (kind for kind in KINDS if kind.name == "datasets")
    assert "mixer_torch.datasets.Crowd" in [m.class_path for m in members(kind, [])]


def test_truth_is_the_same_number_of_people_in_every_frame():
    truth = Crowd(num_people=12, num_frames=40, source="gt").load()
    assert torch.bincount(truth.view).tolist() == [0] + [12] * 40
    seen = torch.stack([truth.view, truth["identity"]])
    assert torch.unique(seen, dim=1).shape == seen.shape
    assert truth["time"].dtype == torch.float64
    assert truth["time"].numpy() == pytest.approx((truth["frame"].numpy() - 1) / 25)


def test_people_walk_and_do_not_jump():
    truth = Crowd(num_people=30, num_frames=200, source="gt").load()
    box, identity, frame = boxes(truth), truth["identity"], truth["frame"]
    lasting = 0
    for person in identity.unique():
        mine = (identity == person).numpy()
        assert (np.diff(frame[mine]) == 1).all()  # who has left does not come back
        height = box[mine, 3] - box[mine, 1]
        step = np.abs(np.diff((box[mine, 0] + box[mine, 2]) / 2))
        # At most about 2.5 m/s at 25 frames/s is 0.1 m, of a stature of 1.4 m and more.
        assert (step < 0.1 / 1.4 * height[1:]).all()
        lasting += mine.sum() > 50
    assert lasting >= 20
    middle = (box[:, :2] + box[:, 2:]) / 2
    assert ((middle > -1e-3) & (middle < (WIDTH + 1e-3, HEIGHT))).all()


def test_without_noise_detections_are_true_boxes_of_those_in_view():
    arguments = {"num_people": 20, "num_frames": 30}
    truth = Crowd(**arguments, source="gt").load()
    found = Crowd(**arguments, box_jitter=0, miss_rate=0, clutter=0).load()
    true = keyed(truth)
    for key, box in keyed(found).items():
        assert np.array_equal(true[key], box)
    assert 0.8 < len(found) / len(truth) < 1


def test_frequencies():
    found = Crowd(num_people=3, num_frames=2000, miss_rate=0.3, clutter=2.0).load()
    clutter = found["identity"] < 0
    assert clutter.sum() / 2000 == pytest.approx(2.0, abs=0.1)
    assert (~clutter).sum() / 6000 == pytest.approx(0.7, abs=0.03)  # three rarely hide each other
    assert found["confidence"][~clutter].mean() > found["confidence"][clutter].mean() + 0.1
    assert float(found["confidence"].min()) >= 0.5
    assert float(found["confidence"].max()) <= 1


def test_jitter_has_the_deviation_asked_for():
    arguments = {"num_people": 5, "num_frames": 1000, "miss_rate": 0.0, "clutter": 0.0}
    clean, noisy = (Crowd(**arguments, box_jitter=j).load() for j in (0, 0.05))

    clean, noisy = keyed(clean), keyed(noisy)
    assert clean.keys() == noisy.keys()
    error = [(noisy[k] - box) / np.tile(box[2:] - box[:2], 2) for k, box in clean.items()]
    assert np.std(error, axis=0) == pytest.approx(0.05, rel=0.05)
    assert np.mean(error, axis=0) == pytest.approx(0, abs=0.005)


def test_visible_share():
    # The second is nearer and covers the left half of the first, the third a quarter of it.
    box = np.array([[0, 0, 4, 4], [0, 0, 2, 4], [2, 0, 4, 2], [9, 9, 10, 10]], float)
    depth = np.array([3.0, 1.0, 2.0, 1.0])
    assert visible_share(box, depth) == pytest.approx([0.5 * 0.75, 1, 1, 1])
    assert visible_share(box[:0], depth[:0]).shape == (0,)


def test_draws_depend_on_the_seed_alone():
    state = np.random.get_state()[1].copy()
    a, b, c = (Crowd(num_people=5, num_frames=20, seed=seed).load() for seed in (3, 3, 4))
    assert torch.equal(a["box"], b["box"])
    assert len(a) != len(c) or not torch.equal(a["box"], c["box"])
    assert np.array_equal(np.random.get_state()[1], state)


def test_a_longer_crowd_begins_like_a_shorter_one():
    short, long = (Crowd(num_people=8, num_frames=n).load() for n in (30, 60))
    first = long.select(long["frame"] <= 30)
    for name in short.features:
        assert torch.equal(first[name], short[name])


@pytest.mark.parametrize("source", ["det", "gt"])
@pytest.mark.parametrize(("people", "frames"), [(0, 0), (0, 5), (3, 0), (1, 1)])
def test_degenerate(people, frames, source):
    found = Crowd(people, frames, miss_rate=0, clutter=0, source=source).load()
    assert len(found) == people * frames
    assert found["box"].shape == (people * frames, 4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_people": -1}, "num_people"),
        ({"num_frames": -2}, "num_frames"),
        ({"seed": True}, "seed"),
        ({"frame_rate": 0.0}, "frame_rate"),
        ({"box_jitter": float("nan")}, "box_jitter"),
        ({"miss_rate": 1.1}, "miss_rate"),
        ({"clutter": -1.0}, "clutter"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        Crowd(**arguments)
