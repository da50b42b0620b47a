"""Endings: against loops, least squares, and boxes worked by hand."""

import numpy as np
import pytest

from mixer_torch.tracking import Tracks
from mixer_torch.tracking.postprocessing import interpolated, smoothed, strong


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


def test_short_faint_and_weak_tracks_are_told():
    tracks = joined(
        line(range(5), 1), line(range(2), 2), line(range(9), 3, confidence=0.5), line(range(6), 4)
    )
    kept = tracks.select(strong(tracks, 3, 0.8))
    assert set(kept.identity) == {1, 4}
    assert set(tracks.select(strong(tracks, 1, 0.0, 5.0)).identity) == {4}
    assert len(strong(tracks.select([]), 3, 0.8)) == 0


def test_typical_confidence_is_a_geometric_mean_of_doubt():
    doubts = np.array([0.01, 0.04, 0.25])
    tracks = line(range(3))
    tracks = Tracks(tracks.frame, tracks.identity, tracks.box, 1.01 - doubts)
    typical = 1.01 - np.prod(doubts) ** (1 / 3)
    assert strong(tracks, 1, typical - 1e-6).all()
    assert not strong(tracks, 1, typical + 1e-6).any()
    unknown = Tracks(tracks.frame, tracks.identity, tracks.box, np.full(3, np.nan))
    assert strong(unknown, 1, 1.0).all()


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
