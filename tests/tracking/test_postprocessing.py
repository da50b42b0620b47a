"""Post-processing: against loops, least squares, and boxes worked by hand."""

import numpy as np
import pytest

from mixer_torch.tracking import Tracks
from mixer_torch.tracking.postprocessing import bandwidth, interpolated, smoothed


def line(frames, identity=1, speed=2.0, confidence=0.9, camera=0):
    frames = np.asarray(frames)
    x = speed * frames.astype(float)
    box = np.stack([x, x, x + 10, x + 30], 1)
    n = len(frames)
    return Tracks(
        frames, np.full(n, identity), box, np.full(n, confidence), np.full(n, camera), np.arange(n)
    )


def joined(*tracks):
    names = ("frame", "identity", "box", "confidence", "camera", "observation")
    return Tracks(*(np.concatenate([getattr(t, name) for t in tracks]) for name in names))


def test_gaps_are_filled_on_a_straight_line():
    full, other = line(range(10)), line(range(10), 2, camera=1)
    holes = joined(full.select([0, 1, 2, 5, 9]), other.select([0, 9]))
    filled = interpolated(holes, 3)
    mine = filled.identity == 1
    assert filled.frame[mine].tolist() == [0, 1, 2, 3, 4, 5, 9]
    assert filled.box[mine] == pytest.approx(full.box[[0, 1, 2, 3, 4, 5, 9]])
    assert (filled.observation[mine] == -1).tolist() == [False] * 3 + [True] * 2 + [False] * 2
    assert (~mine).sum() == 2
    again = interpolated(holes, 100)
    assert len(again) == 20
    assert (again.camera[again.identity == 2] == 1).all()
    assert len(interpolated(holes, 0)) == len(holes)
    assert len(interpolated(holes.select([]), 5)) == 0


def test_of_every_third_frame_no_others_are_filled():
    full = line(range(0, 30, 3))
    filled = interpolated(full.select([0, 1, 4, 9]), 9, step=3)
    assert filled.frame.tolist() == [0, 3, 6, 9, 12, 27]
    assert filled.box == pytest.approx(full.box[[0, 1, 2, 3, 4, 9]])


def test_smoothing_keeps_straight_lines():
    tracks = joined(line([0, 1, 2, 5, 6, 11]), line(range(4), 2, speed=-3.0), line([7], 3))
    assert smoothed(tracks, 2.0).box == pytest.approx(tracks.box)
    assert smoothed(tracks, 0.0) is tracks
    assert len(smoothed(tracks.select([]), 2.0)) == 0


def test_smoothing_is_local_linear_regression():
    rng = np.random.default_rng(0)
    frame = np.array([0, 1, 2, 3, 5, 8, 9])
    box = np.sort(rng.uniform(0, 50, (7, 4)), 1)
    found = smoothed(Tracks(frame, np.ones(7, int), box), 1.5).box
    for i in range(7):
        weight = np.exp(-0.5 * ((frame - frame[i]) / 1.5) ** 2)
        root = np.sqrt(weight)[:, None]
        design = np.stack([np.ones(7), frame - frame[i]], 1)
        fit = np.linalg.lstsq(design * root, box * root, rcond=None)[0][0]
        assert found[i] == pytest.approx(fit, abs=0.15)


@pytest.mark.parametrize(("jitter", "bend"), [(0.02, 0.002), (0.05, 0.01), (0.03, 0.0005)])
def test_the_bandwidth_is_where_error_and_bend_are_least_together(jitter, bend):
    """Against the least of s / sqrt(n) + a n^2 / 8 by trying all n."""
    n = np.arange(1, 400)
    best = n[(jitter / np.sqrt(n) + bend * n**2 / 8).argmin()]
    assert bandwidth(jitter, bend) == pytest.approx(best * 2**0.4, rel=0.25)


def test_boxes_without_jitter_are_left_as_they_are():
    assert bandwidth(0.002, 0.01) == 0
