"""Paths of cameras: products of matrices, worked examples, and there and back again."""

import numpy as np
import pytest
import torch

from mixer_torch.observations import Observations
from mixer_torch.tracking import Tracks
from mixer_torch.tracking.camera_path import CameraPath, accumulated, moved_boxes

CENTRE = np.array([160.0, 120.0])


def similarity(scale=1.0, angle=0.0, shift=(0.0, 0.0)):
    """p -> scale R(angle) (p - CENTRE) + CENTRE + shift."""
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([linear, CENTRE + shift - linear @ CENTRE])


def square(transform):
    return np.vstack([transform, [0, 0, 1]])


def random_steps(count, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack(
        [
            similarity(np.exp(rng.normal() * 0.05), rng.normal() * 0.05, rng.normal(size=2) * 9)
            for _ in range(count)
        ]
    )


def random_path(seed=0):
    transform = accumulated(random_steps(6, seed), CENTRE, np.full(6, 0.9))
    return CameraPath([0, 0, 0, 1, 1, 1], [1, 2, 4, 1, 5, 9], transform)


def test_without_forgetting_it_is_the_product_of_the_inverse_steps():
    steps = random_steps(12)
    found = accumulated(steps, CENTRE, np.ones(12))
    product = np.eye(3)
    for k in range(12):
        product = product @ np.linalg.inv(square(steps[k])) if k else product
        assert found[k] == pytest.approx(product[:2], abs=1e-9)


def test_what_passes_the_middle_rests_there_whatever_is_forgotten():
    steps = random_steps(20)
    found = accumulated(steps, CENTRE, np.full(20, 0.7))
    for k in range(1, 20):
        earlier = (np.linalg.inv(square(steps[k])) @ [*CENTRE, 1])[:2]
        rests = found[k - 1] @ [*earlier, 1]
        assert found[k] @ [*CENTRE, 1] == pytest.approx(rests, abs=1e-9)


def test_a_jerk_is_taken_out_and_then_forgotten():
    steps = np.tile(np.eye(2, 3), (30, 1, 1))
    steps[10] = similarity(scale=1.25, angle=0.2)
    kept = 0.8
    found = accumulated(steps, CENTRE, np.full(30, kept))
    size = np.log(np.linalg.det(found[:, :, :2])) / 2
    angle = np.arctan2(found[:, 1, 0], found[:, 0, 0])
    share = np.where(np.arange(30) < 10, 0, kept ** (np.arange(30) - 9.0))
    assert size == pytest.approx(-np.log(1.25) * share, abs=1e-9)
    assert angle == pytest.approx(-0.2 * share, abs=1e-9)


def test_sizes_stay_in_bounds_when_a_camera_goes_forwards_and_pans_for_long():
    zoom, seconds, memory = 0.1, 0.04, 2.0
    step = similarity(scale=np.exp(zoom * seconds), shift=(-7.0, 0.0))
    kept = np.full(5000, np.exp(-seconds / memory))
    found = accumulated(np.tile(step, (5000, 1, 1)), CENTRE, kept)
    size = np.sqrt(np.linalg.det(found[:, :, :2]))
    assert size.min() >= np.exp(-zoom * memory) * 0.999
    assert size.max() == 1
    assert found[-1, 0] @ [*CENTRE, 1] > 5000 * 5  # the pan itself is never forgotten


def test_boxes_are_moved_and_scaled_and_stay_upright():
    transform = torch.from_numpy(similarity(scale=2.0, angle=np.pi / 2, shift=(3.0, 4.0)))[None]
    # The middle is 30 to the right of the centre; a quarter turn, twice as far, puts it 60 below.
    box = torch.tensor([[180.0, 100.0, 200.0, 140.0]]).double()
    found = moved_boxes(box, transform)
    assert found[0].tolist() == pytest.approx([163 - 20, 184 - 40, 163 + 20, 184 + 40])


def test_there_and_back_again():
    path = random_path()
    rng = np.random.default_rng(1)
    low = rng.uniform(0, 200, (6, 2))
    tracks = Tracks(
        [1, 2, 3, 4, 5, 6],
        [1, 1, 1, 2, 2, 2],
        np.concatenate([low, low + rng.uniform(5, 50, (6, 2))], 1),
        camera=[0, 0, 0, 1, 1, 1],
        observation=np.arange(6),
    )
    steadied = path.steadied(tracks)
    assert np.abs(steadied.box - tracks.box).max() > 1
    back = path.restored(steadied)
    assert back.box == pytest.approx(tracks.box, abs=1e-9)
    for name in ("frame", "identity", "confidence", "camera", "observation"):
        assert getattr(back, name).tolist() == getattr(tracks, name).tolist()


def test_observations_are_moved_as_tracks_are():
    path = random_path()
    frame, camera = torch.tensor([4, 1, 9, 2]), torch.tensor([0, 1, 1, 0])
    box = torch.tensor([[1.0, 2, 11, 32]]).repeat(4, 1)
    box[1] = torch.nan
    seen = Observations(frame + 100 * camera, {"frame": frame, "camera": camera, "box": box})
    found = path.stabilised(seen)
    assert found["box"].dtype == torch.float32
    assert found["box"][1].isnan().all()
    for row in (0, 2, 3):
        where = path.at(camera[row : row + 1], frame[row : row + 1])
        expected = moved_boxes(box[row : row + 1].double(), torch.from_numpy(where))
        assert found["box"][row].tolist() == pytest.approx(expected[0].tolist(), rel=1e-5)
    assert torch.equal(seen["box"][0], box[0])


def test_between_frames_on_a_line_and_at_rest_outside():
    path = random_path()
    found = path.at([0, 0, 0], [3, -5, 99])
    first, second, last = path.transform[:3]
    expected = np.stack([(second + last) / 2, first, last])
    assert found == pytest.approx(expected)


def test_frames_in_any_order():
    path = random_path()
    order = np.array([3, 5, 0, 2, 1, 4])
    shuffled = CameraPath(path.camera[order], path.frame[order], path.transform[order])
    assert np.array_equal(shuffled.transform, path.transform)
    assert len(shuffled) == 6


def test_bad_paths():
    eye = np.tile(np.eye(2, 3), (2, 1, 1))
    with pytest.raises(ValueError, match="transform"):
        CameraPath([0, 0], [1, 2], eye[:1])
    with pytest.raises(ValueError, match="frame: expected each one once, got 2"):
        CameraPath([0, 0], [2, 2], eye)
    with pytest.raises(ValueError, match="camera"):
        CameraPath([0, 0], [1, 2], eye).at([3], [1])
