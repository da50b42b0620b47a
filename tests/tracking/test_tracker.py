"""The tracker on people whose identity is known by construction, and on real sequences."""

import itertools
from importlib import resources

import numpy as np
import pytest
import torch
import yaml

from mixer_torch.association import by_first_appearance
from mixer_torch.observations import Images, Observations
from mixer_torch.scorers import Color, Motion
from mixer_torch.tracking import Tracker
from mixer_torch.tracking.appearance import with_looks
from mixer_torch.tracking.tracklets import overlapping, summarised, with_paths


def tracker(**settings):
    """The tracker of configs/track.yaml."""
    text = (resources.files("mixer_torch.configs") / "track.yaml").read_text()
    config = yaml.safe_load(text)["tracker"]["init_args"]
    ours = {
        name: [Motion(**item.get("init_args", {})) for item in config[name]]
        for name in ("scorers", "tracklet_scorers")
    }
    return Tracker(**{**ours, "min_strength": 0.0, "smoothing": 0.0, **settings})


def people(paths, frames, rate=20.0, noise=1.0, seed=0, hidden=()):
    """Boxes 100 pixels high on paths, and who they are; (who, first, last frame) are hidden."""
    rng = np.random.default_rng(seed)
    rows = []
    for frame, (who, path) in itertools.product(range(1, frames + 1), enumerate(paths)):
        if any(who == k and a <= frame <= b for k, a, b in hidden):
            continue
        x, y = path((frame - 1) / rate) + rng.normal(size=2) * noise
        rows.append((frame, who, x - 20, y - 50, x + 20, y + 50))
    table = np.array(rows)
    frame = torch.tensor(table[:, 0]).long()
    features = {
        "frame": frame,
        "time": (frame - 1).double() / rate,
        "box": torch.tensor(table[:, 2:]).float(),
        "confidence": torch.full((len(table),), 0.99),
    }
    return Observations(frame, features), torch.tensor(table[:, 1]).long()


def straight(x, y, vx, vy=0.0):
    return lambda t: np.array([x + vx * t, y + vy * t])


def same(found, expected):
    return by_first_appearance(found).tolist() == by_first_appearance(expected).tolist()


CROSSING = [straight(0, 0, 80), straight(300, 5, -80), straight(150, 200, 0)]


def test_people_who_cross():
    observations, who = people(CROSSING, 70)
    assert same(tracker().associate(observations).labels, who)


def test_a_gap_is_bridged_by_tracklets_alone():
    observations, who = people(CROSSING, 80, hidden=[(0, 30, 55)])
    assert same(tracker().associate(observations).labels, who)
    apart = tracker(gaps=[]).associate(observations).labels
    assert len(apart.unique()) == 4


def test_tracklets_that_overlap_are_never_joined():
    paths = [straight(0, 0, 20), straight(4, 2, 20), straight(8, -2, 20)]
    hidden = [(0, 20, 30), (1, 25, 40), (2, 35, 50)]
    observations, _ = people(paths, 70, noise=3.0, hidden=hidden)
    ours = tracker()
    labels = ours.begin(observations)
    pairs = ours.pairs(observations)
    labels = ours.link(observations, labels, pairs).labels
    tracklets = summarised(with_paths(observations, labels, ours.model), labels)
    apart = overlapping(tracklets["span"])
    assert apart.shape[1] > 2
    for gap in (0.5, 4.0):
        joined = ours.join(observations, labels, gap)
        name = torch.zeros(len(tracklets), dtype=torch.int64)
        name[labels] = joined
        assert (name[apart[0]] != name[apart[1]]).all()


def test_settled_tracklets_stay_apart():
    observations, who = people([straight(0, 0, 50)], 40, hidden=[(0, 15, 20)])
    labels = (observations["frame"] > 20).long()
    assert same(tracker().join(observations, labels, 1.0), who)
    settled = torch.tensor([True, True])
    assert same(tracker().join(observations, labels, 1.0, settled), labels)


def test_order_of_observations_makes_no_difference():
    observations, who = people(CROSSING, 50, hidden=[(1, 10, 20)])
    order = torch.randperm(len(who), generator=torch.Generator().manual_seed(0))
    labels = tracker().associate(observations.select(order)).labels
    assert same(labels, who[order])


@pytest.mark.parametrize("frames", [0, 1])
def test_next_to_nothing(frames):
    observations, who = people(CROSSING, 1)
    observations = observations.select(torch.arange(len(who) * frames))
    ours = tracker()
    association = ours.associate(observations)
    assert association.labels.tolist() == list(range(3 * frames))
    assert association.stats["clusters"] == 3 * frames
    assert len(ours.track(observations)) == 0


def test_a_long_stretch_without_detections():
    observations, who = people(CROSSING[:1], 60)
    late = observations.with_features(
        frame=observations["frame"] + 5000, time=observations["time"] + 250
    )
    both = Observations(
        torch.cat([observations.view, late.view + 5000]),
        {k: torch.cat([observations[k], late[k]]) for k in observations.features},
    )
    tracks = tracker(fill=2.0).track(both)
    assert len(tracks) == 2 * len(who)
    assert len(np.unique(tracks.identity)) == 2


def test_cameras_are_not_linked_by_motion():
    observations, who = people([straight(0, 0, 20)], 30)
    twice = Observations(
        torch.cat([2 * observations.view, 2 * observations.view + 1]),
        {k: torch.cat([v, v]) for k, v in observations.features.items()}
        | {"camera": torch.tensor([0, 1]).repeat_interleave(len(who))},
    )
    assert same(tracker().associate(twice).labels, twice["camera"])


def test_tracks_are_filled_and_the_weak_dropped():
    observations, _ = people(CROSSING, 60, noise=0.0, hidden=[(0, 20, 25), (1, 4, 60)])
    tracks = tracker(min_boxes=4).track(observations)
    assert len(np.unique(tracks.identity)) == 2
    filled = tracks.select(tracks.observation < 0)
    assert filled.frame.tolist() == [20, 21, 22, 23, 24, 25]
    expected = [80 * (frame - 1) / 20 for frame in range(20, 26)]
    assert filled.box[:, [0, 2]].mean(1) == pytest.approx(expected, abs=0.1)
    assert not (tracker(min_boxes=4, fill=0.0).track(observations).observation < 0).any()


def test_looks_tell_who_goes_on():
    """Two who stand change places unseen, each in a colour of their own."""
    paths = [
        lambda t: np.array([200.0 if t > 1.5 else 150.0, 100.0]),
        lambda t: np.array([150.0 if t > 1.5 else 200.0, 100.0]),
    ]
    observations, who = people(paths, 60, hidden=[(0, 20, 42), (1, 20, 42)])
    frames = [np.full((200, 400, 3), 90, np.uint8) for _ in range(60)]
    for row, k in enumerate(who):
        x1, y1, x2, y2 = observations["box"][row].int().clamp(min=0).tolist()
        frame = frames[int(observations["frame"][row]) - 1]
        frame[y1:y2, x1:x2] = [(200, 30, 30), (30, 30, 200)][int(k)]
    images = Images(frames, observations["frame"].numpy() - 1, observations["box"].numpy())
    seen = Observations(observations.view, observations.features, images)
    colour = Color("histogram", slope=8.0, midpoint=0.5)
    assert not same(tracker().associate(seen).labels, who)
    assert same(tracker(appearance=[colour]).associate(seen).labels, who)


def test_looks_have_to_be_vectors():
    observations, _ = people(CROSSING, 2)
    images = Images([np.zeros((9, 9, 3), np.uint8)] * 2, observations["frame"].numpy() - 1)
    seen = Observations(observations.view, observations.features, images)
    with pytest.raises(ValueError, match="appearance"):
        with_looks(seen, [Color("semantic")])
    with pytest.raises(KeyError, match="images"):
        with_looks(observations, [Color("histogram")])


@pytest.mark.parametrize(
    "settings",
    [{"passes": 0}, {"patience": -1.0}, {"fill": -1.0}, {"gaps": [0.0]}, {"scorers": []}],
)
def test_bad_settings(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        tracker(**settings)


def test_boxes_have_to_be_finite():
    observations, _ = people(CROSSING, 3)
    box = observations["box"].clone()
    box[4, 2] = torch.nan
    with pytest.raises(ValueError, match="box"):
        tracker().associate(observations.with_features(box=box))


@pytest.mark.real_data
def test_better_than_the_trackers_of_today(real_data):
    """Identities at least as good as the targets, on the shorter two of the real sequences."""
    from mixer_torch.datasets import MOTChallenge
    from mixer_torch.io.motchallenge import read_truth
    from mixer_torch.metrics.tracking import evaluate_tracks
    from mixer_torch.tracks import Tracks

    for name, least in (("KITTI-17", 0.75), ("TUD-Stadtmitte", 0.8)):
        folder = real_data / "mot15" / name
        observations = MOTChallenge(folder, pixels=False).load()
        tracks = tracker(min_strength=10.0, smoothing=0.3).track(observations)
        rows = read_truth(folder / "gt" / "gt.txt")
        box = np.concatenate([rows[:, 2:4], rows[:, 2:4] + rows[:, 4:6]], 1)
        truth = Tracks(rows[:, 0].astype(int), rows[:, 1].astype(int), box)
        assert evaluate_tracks(tracks, truth)["IDF1"] > least
