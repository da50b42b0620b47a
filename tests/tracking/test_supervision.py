import sys

import numpy as np
import pytest
import torch
from drawn_tracks import assert_same, drawn_tracks
from hypothesis import given

from mixer_torch.observations import Observations
from mixer_torch.tracking import Tracks
from mixer_torch.tracking.supervision import (
    from_supervision,
    observations_from_supervision,
    to_supervision,
)

supervision = pytest.importorskip("supervision")
BOX = [[0, 0, 1, 1], [1, 1, 2, 2], [2, 2, 3, 3.5]]


@given(drawn_tracks())
def test_tracks_go_there_and_back(columns):
    columns["confidence"] = np.nan_to_num(columns["confidence"], nan=0.5)
    tracks = Tracks(**columns)
    assert_same(from_supervision(to_supervision(tracks, 0), 0), tracks)


def test_every_frame_has_its_detections():
    tracks = Tracks([2, 2, 4], [3, 1, 1], BOX, [0.1, 0.2, np.nan])
    frames = to_supervision(tracks, last_frame=5)
    assert [len(frame) for frame in frames] == [0, 2, 0, 1, 0]
    assert all(isinstance(frame, supervision.Detections) for frame in frames)
    assert frames[1].tracker_id.tolist() == [1, 3]
    assert frames[1].confidence is None
    assert [len(frame) for frame in to_supervision(tracks, 3)] == [0, 1]
    assert to_supervision(Tracks([], [], [])) == []
    assert len(from_supervision(frames)) == 3


def test_a_tracker_of_that_world_takes_and_gives_them():
    trackers = pytest.importorskip("trackers")
    frame = torch.arange(1, 9)
    left = 3.0 * frame
    box = torch.stack([left, 0 * left, left + 30, 0 * left + 60], 1)
    seen = Observations(frame, {"frame": frame, "box": box, "confidence": torch.ones(8)})
    tracker = trackers.SORTTracker()
    tracks = from_supervision([tracker.update(found) for found in to_supervision(seen)])
    assert len(tracks) >= 4
    assert set(tracks.identity) == {1}
    assert tracks.frame[-1] == 8
    np.testing.assert_array_equal(tracks.observation, tracks.frame - 1)


def test_identities_from_zero_and_boxes_of_no_track():
    found = supervision.Detections(np.array(BOX), tracker_id=np.array([0, -1, 4]))
    tracks = from_supervision([supervision.Detections.empty(), found], first_frame=10)
    assert tracks.identity.tolist() == [1, 5]
    assert tracks.frame.tolist() == [11, 11]
    assert np.isnan(tracks.confidence).all()
    assert len(from_supervision([])) == 0


def test_detections_become_observations():
    found = supervision.Detections(np.array(BOX), confidence=np.array([0.5, 1, 0.25]))
    seen = observations_from_supervision([found, supervision.Detections.empty(), found[1]], 5, 10)
    assert seen.view.tolist() == seen["frame"].tolist() == [5, 5, 5, 7]
    assert seen["time"].tolist() == [0.5, 0.5, 0.5, 0.7]
    assert seen["confidence"].tolist() == [0.5, 1, 0.25, 1]
    assert seen["box"][3].tolist() == BOX[1]
    assert len(observations_from_supervision([])) == 0


def test_observations_become_detections():
    box = torch.tensor(BOX, dtype=torch.float32)
    box[1] = torch.nan
    seen = Observations(torch.tensor([1, 2, 1]), {"frame": torch.tensor([1, 2, 1]), "box": box})
    frames = to_supervision(seen)
    assert [len(frame) for frame in frames] == [2]
    assert frames[0].tracker_id is None
    assert frames[0].confidence is None
    assert frames[0].data["observation"].tolist() == [0, 2]
    assert to_supervision(seen.with_features(confidence=torch.ones(3)))[0].confidence.sum() == 2


def test_mistakes_are_named(monkeypatch):
    found = supervision.Detections(np.array(BOX))
    with pytest.raises(ValueError, match="detections of frame 3 have no tracker_id"):
        from_supervision([supervision.Detections.empty(), found], 2)
    found.tracker_id = np.array([1, 1, 2])
    with pytest.raises(ValueError, match="got two of 1 in frame 1"):
        from_supervision([found])
    with pytest.raises(ValueError, match="frame_rate: expected a positive number, got 0"):
        observations_from_supervision([], frame_rate=0)
    with pytest.raises(ValueError, match="expected one camera, got 0, 1"):
        to_supervision(Tracks([1, 1], [1, 1], BOX[:2], camera=[0, 1]))
    monkeypatch.setitem(sys.modules, "supervision", None)
    with pytest.raises(ImportError, match="pip install supervision"):
        to_supervision(Tracks([1], [1], BOX[:1]))
