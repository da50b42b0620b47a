"""Frame by frame, with `supervision.Detections` in and out, or what looks like them."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from mixer_torch.datasets.simulated import Scene, Simulated
from mixer_torch.tracking import Tracker


@dataclass
class Detections:
    """As much of `supervision.Detections` as a tracker touches."""

    xyxy: np.ndarray
    confidence: np.ndarray | None = None
    class_id: np.ndarray | None = None
    mask: np.ndarray | None = None
    tracker_id: np.ndarray | None = None
    data: dict = field(default_factory=dict)

    def __len__(self):
        return len(self.xyxy)

    def __getitem__(self, rows):
        def of(value):
            return None if value is None else value[rows]

        data = {key: value[rows] for key, value in self.data.items()}
        kept = (of(v) for v in (self.confidence, self.class_id, self.mask, self.tracker_id))
        return Detections(self.xyxy[rows], *kept, data)


def frames(scene, seed=0):
    seen = Simulated(scene, seed).load()
    frame = seen["frame"].numpy()
    for t in range(1, scene.frames + 1):
        rows = np.flatnonzero(frame == t)
        yield Detections(
            seen["box"].double().numpy()[rows],
            seen["confidence"].numpy()[rows],
            class_id=np.zeros(len(rows), dtype=int),
            mask=rows[:, None, None] * np.ones((1, 2, 2)),
            data={"row": rows, "identity": seen["identity"].numpy()[rows]},
        )


SCENE = Scene(frames=80, things=8, speed=0.6, clutter=0.3)


def test_tracks_come_out_with_all_that_went_in():
    tracker = Tracker(frame_rate=25)
    told, rows = {}, 0
    for detections in frames(SCENE):
        found = tracker.update(detections)
        assert len(found.tracker_id) == len(found) == len(found.mask) == len(found.data["row"])
        assert (found.mask[:, 0, 0] == found.data["row"]).all()
        assert len(set(found.tracker_id.tolist())) == len(found)
        for who, true in zip(found.tracker_id.tolist(), found.data["identity"], strict=True):
            told.setdefault(who, []).append(int(true))
        rows += len(found)
    assert sorted(told) == list(range(1, len(told) + 1))
    right = sum(max(map(values.count, set(values))) for values in told.values())
    assert right / rows > 0.9


def test_the_first_frames_and_empty_ones_are_normal_input():
    tracker = Tracker(frame_rate=25)
    nothing = Detections(np.zeros((0, 4)), np.zeros(0))
    assert len(tracker.update(nothing)) == 0
    for k, detections in enumerate(frames(SCENE)):
        found = tracker.update(nothing if k == 5 else detections)
        assert found.tracker_id is not None


def test_a_sequence_may_begin_anew():
    tracker = Tracker(frame_rate=25)

    def run():
        return [tracker.update(one).tracker_id.tolist() for one in frames(SCENE)]

    first = run()
    tracker.reset()
    assert run() == first


def test_classes_are_kept_apart_and_confidence_is_not_needed():
    tracker = Tracker(frame_rate=25)
    kinds = {}
    for detections in frames(SCENE):
        kind = detections.data["identity"] % 2
        given = replace(detections, class_id=kind, confidence=None)
        found = tracker.update(given)
        for who, one in zip(found.tracker_id.tolist(), found.class_id.tolist(), strict=True):
            assert kinds.setdefault(who, one) == one


def test_with_the_package_itself():
    supervision = pytest.importorskip("supervision")
    tracker = Tracker(frame_rate=25)
    for one in frames(SCENE):
        given = supervision.Detections(xyxy=one.xyxy, confidence=one.confidence, data=one.data)
        found = tracker.update(given)
    assert isinstance(found, supervision.Detections)
    assert len(found.data["row"]) == len(found.tracker_id) > 0
