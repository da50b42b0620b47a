"""Colour casts of cameras: what balancing undoes, and what it leaves."""

import numpy as np
import pytest

from mixer_torch.datasets.balance import BalancedFrames, brightness_transfer, channel_histograms


def scenes(count=40, seed=0):
    generator = np.random.default_rng(seed)
    return list(generator.integers(20, 180, (count, 12, 8, 3)).astype(np.uint8))


def cast(frame):
    """A monotone map of each channel, brighter and bluer."""
    level = frame / 255
    return np.round(255 * np.stack([level[..., k] ** g for k, g in enumerate((1, 0.8, 0.6))], -1))


def test_a_cast_is_taken_off():
    same = scenes()
    frames = same + [cast(frame).astype(np.uint8) for frame in same]
    balanced = BalancedFrames(frames, np.repeat([7, 3], len(same)))
    assert len(balanced) == len(frames)
    for i in range(len(same)):
        one, other = (balanced[j].astype(int) for j in (i, i + len(same)))
        assert np.abs(one - other).max() <= 2
        assert balanced[i].dtype == np.uint8
        assert balanced[i].shape == same[i].shape


def test_common_ground_lies_in_the_middle_and_order_stays():
    dark, bright = np.zeros((2, 3, 256))
    dark[:, 50:101] = 1
    bright[:, 150:201] = 1
    tables = brightness_transfer(np.stack([dark, bright])).astype(int)
    assert np.abs(tables[0, :, 50:101] - np.arange(100, 151)).max() <= 1
    assert np.abs(tables[1, :, 150:201] - np.arange(100, 151)).max() <= 1
    assert (np.diff(tables, axis=-1) >= 0).all()


def test_one_camera_stays_as_it_is():
    frames = scenes()
    balanced = BalancedFrames(frames, np.zeros(len(frames), int))
    assert max(np.abs(balanced[i].astype(int) - frames[i]).max() for i in range(40)) <= 1


def test_the_middle_counts_most():
    frame = np.zeros((4, 9, 3), np.uint8)
    frame[:, 4] = 200
    histogram = channel_histograms([frame], np.zeros(1, int))
    assert histogram.shape == (1, 3, 256)
    # With a standard deviation of 0.12 widths, a pixel at the rim counts exp(-6.86).
    assert histogram[0, 0, 200] > 8 * histogram[0, 0, 0] / 20
    assert histogram[0, 0, 200] == pytest.approx(4)


def test_nothing():
    assert len(BalancedFrames([], np.zeros(0, int))) == 0
