"""Online tracking: chunks make no difference, what is settled stays, the end is as offline."""

import copy
import math
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import torch
import yaml

from mixer_torch.datasets import Crowd
from mixer_torch.metrics.tracking import evaluate_tracks
from mixer_torch.observations import Images, Observations
from mixer_torch.pairs import Reachable
from mixer_torch.scorers import Motion
from mixer_torch.scoring import Scorer
from mixer_torch.solvers.local_search import LocalSearch
from mixer_torch.tracking import CameraMotion, Tracker, Tracks
from mixer_torch.tracking.online import OnlineTracker


def online(window=0.4, **arguments):
    tracker = Tracker(
        [Motion()],
        [Motion()],
        pairs=Reachable(window=0.4),
        solver=LocalSearch(restarts=2),
        gaps=[1.0],
        min_confidence=0.5,
    )
    return OnlineTracker(tracker, window=window, **arguments)


def crowd(people=4, frames=40, **arguments):
    return Crowd(people, frames, frame_rate=10.0, clutter=0.5, **arguments).load()


def in_chunks(observations, size):
    """The observations of every ``size`` frames."""
    frame = observations["frame"]
    for first in range(1, int(frame.max()) + 1, size):
        yield observations.select((frame >= first) & (frame < first + size))


def followed(tracker, chunks):
    """The last label of each observation, whether it is settled, and all latencies."""
    label, settled, latency = {}, {}, []
    for chunk in chunks:
        update = tracker.update(chunk)
        latency += update.latency
        for i, name, fixed in zip(
            *(x.tolist() for x in (update.observation, update.label, update.settled)), strict=True
        ):
            assert not settled.get(i, False), "said again of what was settled"
            label[i], settled[i] = name, fixed
    return label, settled, latency


def test_chunks_make_no_difference():
    seen = crowd()
    one, settled, _ = followed(online(), in_chunks(seen, 1))
    seven = followed(online(), in_chunks(seen, 7))
    together = followed(online(), [seen])
    assert seven[:2] == (one, settled)
    assert together[:2] == (one, settled)
    late = seen["time"] > seen["time"].max() - 0.4
    assert [settled[i] for i in range(len(seen))] == (~late).tolist()
    association = online().associate(seen)
    label = torch.tensor([one[i] for i in range(len(seen))])
    assert same_clusters(association.labels, label)


def same_clusters(a, b):
    """Whether labels differ in their names alone."""
    both = torch.unique(torch.stack([a, b]), dim=1)
    return both.shape[1] == len(a.unique()) == len(b.unique())


def test_labels_of_a_frame_are_distinct_at_all_times():
    tracker, seen = online(), crowd()
    for chunk in in_chunks(seen, 1):
        update = tracker.update(chunk)
        place = torch.stack([seen["frame"][update.observation], update.label])
        assert torch.unique(place, dim=1).shape == place.shape


@pytest.mark.parametrize(("seed", "window"), [(0, 0.0), (1, 0.1), (2, 0.3), (3, 0.3)])
def test_what_is_settled_stays(seed, window):
    seen = crowd(people=3, frames=8, seed=seed, miss_rate=0.3)
    # `followed` fails where anything is said again of what was settled.
    label, settled, _ = followed(online(window), in_chunks(seen, 1))
    assert sorted(label) == list(range(len(seen)))
    late = seen["time"] > seen["time"].max() - window
    assert [settled[i] for i in range(len(seen))] == (~late).tolist()


def test_everything_settled_at_once_is_still_tracked():
    seen = crowd(people=2, frames=30, miss_rate=0.0, box_jitter=0.01)
    tracker = online(window=0.0)
    score = evaluate_tracks(tracker.track(seen), truth(people=2, frames=30))
    assert score["IDF1"] > 70


def truth(**arguments):
    true = crowd(source="gt", **arguments)
    return Tracks.from_labels(true, true["identity"])


def test_the_end_is_as_good_as_offline():
    arguments = {"people": 5, "frames": 50, "seed": 1}
    seen, tracker = crowd(**arguments), online(window=1.0)
    scores = [
        evaluate_tracks(each.track(seen), truth(**arguments))["IDF1"]
        for each in (tracker, tracker.tracker)
    ]
    assert scores[0] > scores[1] - 2


def test_a_gap_is_bridged_and_the_label_goes_on():
    # One walks by, is not seen for 0.7 s, which is longer than the window, and goes on.
    t = np.r_[0:1:0.1, 1.7:2.7:0.1]
    x = 100 + 50 * t
    box = np.stack([x, 100 + 0 * t, x + 40, 200 + 0 * t], 1)
    label = online(window=0.3).associate(observed(t, box)).labels
    assert label.tolist() == [0] * len(t)


def observed(t, box):
    frame = torch.from_numpy(np.round(10 * t).astype(np.int64)) + 1
    features = {
        "frame": frame,
        "time": torch.from_numpy(t),
        "box": torch.from_numpy(box),
        "confidence": torch.ones(len(t)),
    }
    return Observations(frame, features)


def test_two_settled_objects_are_never_joined():
    # Two stretches of one path, seen apart for longer than is ever compared; then nothing new.
    t = np.r_[0:1:0.1, 3:4:0.1]
    box = np.tile([100.0, 100.0, 140.0, 200.0], (len(t), 1))
    label = online(window=0.3).associate(observed(t, box)).labels
    assert label.tolist() == [0] * 10 + [1] * 10


def test_memory_is_bounded():
    tracker = online(memory=5)
    sizes = []
    for chunk in in_chunks(crowd(people=3, frames=70), 1):
        tracker.update(chunk)
        sizes.append(len(tracker._stretch.number))
    assert max(sizes[40:]) < 1.3 * max(sizes[20:40])


def test_latency_of_every_frame():
    seen = crowd(frames=20)
    assert len(torch.unique(seen["frame"])) == 20
    update = online().update(seen)
    assert len(update.latency) == 20
    assert all(0 < seconds < 60 for seconds in update.latency)
    told = []
    association = online().associate(seen, lambda *what: told.append(what))
    assert len(association.stats["latency"]) == 20
    assert told[-1] == ("frames", 20, 20)
    assert math.isnan(association.objective)


def test_no_observations():
    tracker, seen = online(), crowd(frames=6)
    none = seen.select(seen["frame"] < 0)
    assert len(tracker.update(none).observation) == 0
    first = tracker.update(seen)
    again = tracker.update(none)
    assert again.latency == ()
    open_ = ~first.settled
    assert torch.equal(again.observation, first.observation[open_])
    assert torch.equal(again.label, first.label[open_])
    assert len(tracker.track(none)) == 0
    assert len(tracker.associate(none).labels) == 0


def test_frames_in_which_nothing_is_seen():
    seen = crowd(frames=40)
    holes = seen.select((seen["frame"] < 10) | (seen["frame"] > 35))
    label, _, latency = followed(online(), in_chunks(holes, 1))
    assert len(label) == len(holes)
    assert len(latency) == len(torch.unique(holes["frame"]))


def test_any_order_within_a_chunk():
    seen = crowd(frames=15)
    order = torch.from_numpy(np.random.default_rng(0).permutation(len(seen)))
    shuffled = online().associate(seen.select(order)).labels
    assert same_clusters(shuffled, online().associate(seen).labels[order])


def test_frames_out_of_order():
    tracker, seen = online(), crowd(frames=10)
    tracker.update(seen.select(seen["frame"] <= 5))
    before = copy.copy(tracker._stretch)
    with pytest.raises(ValueError, match=r"frames in order of time, after 0\.4 s, got one of 0\.2"):
        tracker.update(seen.select(seen["frame"] == 3))
    assert tracker._stretch == before  # and nothing has changed
    with pytest.raises(ValueError, match="in order of time"):
        tracker.update(seen.select(seen["frame"] == 5))
    tracker.update(seen.select(seen["frame"] == 6))
    tracker.reset()
    assert tracker.update(seen.select(seen["frame"] == 3)).observation[0] == 0


def test_time_has_to_be_known():
    seen = crowd(frames=3)
    with pytest.raises(ValueError, match="time: expected finite"):
        online().update(seen.with_features(time=torch.full((len(seen),), math.nan)))


def test_the_motion_of_the_camera_is_not_known_online():
    inner = Tracker([Motion()], [Motion()], camera_motion=CameraMotion())
    with pytest.raises(ValueError, match="camera_motion is for whole sequences"):
        OnlineTracker(inner)


def test_features_stay_the_same():
    tracker, seen = online(), crowd(frames=3)
    tracker.update(seen.select(seen["frame"] == 1))
    more = seen.with_features(weight=torch.zeros(len(seen)))
    with pytest.raises(ValueError, match=r"expected features .*, as before, got .*weight"):
        tracker.update(more.select(more["frame"] == 2))


def test_inputs_are_not_written_to():
    seen = crowd(frames=5)
    before = {name: value.clone() for name, value in seen.features.items()}
    online().track(seen)
    assert all(torch.equal(seen[name], value) for name, value in before.items())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"window": -1.0}, "window"),
        ({"window": math.inf}, "window"),
        ({"passes": 0}, "passes"),
        ({"memory": 0}, "memory"),
        ({"recall": -0.1}, "recall"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        online(**arguments)


class Grey(Scorer):
    """Same grey, same object; says which crops it has seen."""

    needs = ("images",)

    def describe(self, observations):
        crops = [(i, crop) for i, crop in observations.images.crops()]
        return torch.tensor([float(crop.mean()) for _, crop in sorted(crops, key=first)])

    def compare(self, description, pairs):
        return torch.where((description[pairs[0]] - description[pairs[1]]).abs() < 5, 0.9, 0.1)


def first(pair):
    return pair[0]


def test_pixels_are_read_once_and_held_while_they_are_of_use():
    # Two that stand on one spot in turn, and differ in grey alone.
    frames = [np.full((8, 8, 3), 40 if k % 2 else 200, np.uint8) for k in range(12)]
    t = np.arange(12) / 10
    seen = observed(t, np.tile([0.0, 0.0, 8.0, 8.0], (12, 1)))
    tracker = online(window=0.2, recall=0.3, memory=3)
    tracker.tracker.scorers = [Grey()]
    tracker.tracker.gaps = ()
    label = {}
    for k in range(12):
        images = Images([frames[k]], np.zeros(1, int), np.array([[0.0, 0.0, 8.0, 8.0]]))
        update = tracker.update(replace(seen.select(seen["frame"] == k + 1), images=images))
        label |= dict(zip(update.observation.tolist(), update.label.tolist(), strict=True))
    assert [label[k] for k in range(12)] == [0, 1] * 6
    assert len(tracker._stretch.observations.images.frames) <= 8


def test_configurations_differ_in_the_solver_alone():
    read = [
        yaml.safe_load(path.read_text())["tracker"]
        for path in (
            resources.files("mixer_torch.configs") / "track.yaml",
            resources.files("mixer_torch.benchmarks") / "configs" / "tracking" / "online.yaml",
        )
    ]
    inner = read[1]["init_args"]["tracker"]
    assert inner["init_args"].pop("solver")["class_path"].endswith("LocalSearch")
    read[0]["init_args"].pop("solver", None)
    assert inner == read[0]
