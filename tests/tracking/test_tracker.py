"""The tracker as it is used: offline, online, frame by frame, and on what is not quite right."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from mixer_torch.datasets.simulated import Scene, Simulated
from mixer_torch.metrics.tracking import evaluate_tracks
from mixer_torch.observations import Observations
from mixer_torch.scorers import Color, Proximity
from mixer_torch.tracking import (
    CameraPath,
    Joining,
    Linking,
    PostProcessing,
    Tracker,
    Tracks,
)

SCENE = Scene(frames=90, things=8, speed=0.6, clutter=0.3, miss=0.03)


@pytest.fixture(scope="module")
def seen():
    return Simulated(SCENE, 1).load()


@pytest.fixture(scope="module")
def truth():
    found = Simulated(replace(SCENE, truth_of_hidden=False), 1, "gt").load()
    return Tracks.from_labels(found, found["identity"])


def with_features(observations, **features):
    return observations.with_features(**features)


def pairs_of(tracks):
    """Which observations are of one object, as a set of pairs."""
    row = tracks.observation >= 0
    order = np.lexsort((tracks.frame[row], tracks.identity[row]))
    who, what = tracks.identity[row][order], tracks.observation[row][order]
    same = who[1:] == who[:-1]
    return set(zip(what[:-1][same].tolist(), what[1:][same].tolist(), strict=True))


def agreement(a, b):
    """Share of the successive pairs of either result that both have."""
    first, second = pairs_of(a), pairs_of(b)
    return len(first & second) / max(len(first | second), 1)


@pytest.mark.parametrize("online", [False, True], ids=["offline", "online"])
def test_a_scene_is_followed(seen, truth, online):
    found = evaluate_tracks(Tracker(online=online).track(seen), truth)
    assert found["IDF1"] > 80
    assert found["HOTA"] > 70


def test_every_observation_has_a_label_and_what_was_measured_is_told(seen):
    answer = Tracker().associate(seen)
    assert len(answer.labels) == len(seen)
    assert int(answer.labels.min()) == 0
    assert "camera" in str(answer.stats["measured"][0])
    key = torch.stack([answer.labels, seen["frame"]])
    assert len(key.unique(dim=1).T) == len(seen)


def test_the_same_input_gives_the_same_tracks_in_any_order(seen):
    order = torch.randperm(len(seen), generator=torch.Generator().manual_seed(0))
    features = {name: value[order] for name, value in seen.features.items()}
    mixed = Observations(seen.view[order], features)
    a, b = Tracker().track(seen), Tracker().track(mixed)
    back = replace(b, observation=np.append(order.numpy(), -1)[b.observation])
    assert agreement(a, back) > 0.99


SCALES = {
    "shifted": lambda c: 0.9 * c - 0.05,
    "percents": lambda c: 100 * c,
    "logits": torch.logit,
}


@pytest.mark.parametrize("scale", SCALES.values(), ids=SCALES)
def test_the_scale_of_scores_does_not_matter(seen, scale):
    other = seen.with_features(confidence=scale(seen["confidence"].double()))
    assert agreement(Tracker().track(seen), Tracker().track(other)) > 0.95


def test_a_score_that_is_not_known_is_the_middle_one(seen):
    score = seen["confidence"].clone()
    alone = torch.arange(len(score)) % 7 == 0
    known = seen.with_features(confidence=score.where(~alone, score[~alone].double().median()))
    unknown = seen.with_features(confidence=score.where(~alone, torch.nan))
    none = seen.with_features(confidence=torch.full_like(score, torch.nan))
    alike = seen.with_features(confidence=torch.ones_like(score))
    for a, b in ((known, unknown), (none, alike)):
        assert (
            Tracker().associate(a).labels == Tracker().associate(b).labels
        ).float().mean() > 0.99


def test_scores_that_are_all_alike_still_give_tracks(seen, truth):
    alike = seen.with_features(confidence=torch.ones(len(seen)))
    assert evaluate_tracks(Tracker().track(alike), truth)["IDF1"] > 70


@pytest.mark.parametrize("factor", [10, 1e-3])
def test_the_scale_of_boxes_does_not_matter(seen, factor):
    other = seen.with_features(box=(factor * seen["box"].double()).float())
    a, b = Tracker().track(seen), Tracker().track(other)
    assert agreement(a, b) > 0.99
    assert len(a) == pytest.approx(len(b), rel=0.02)


def test_half_the_frame_rate_follows_the_same_things(truth):
    scene = replace(SCENE, frames=180)
    seen = Simulated(scene, 1).load()
    half = seen["frame"] % 2 == 1
    features = {name: value[half] for name, value in seen.features.items()}
    found = Simulated(replace(scene, truth_of_hidden=False), 1, "gt").load()
    kept = found["frame"] % 2 == 1
    fewer = Tracks.from_labels(found, found["identity"]).select(kept.numpy().nonzero()[0])
    part = Observations(seen.view[half], features)
    whole = evaluate_tracks(Tracker().track(seen), Tracks.from_labels(found, found["identity"]))
    assert (
        evaluate_tracks(Tracker(post=PostProcessing(fill=0)).track(part), fewer)["IDF1"]
        > whole["IDF1"] - 10
    )


@pytest.mark.parametrize("online", [False, True])
def test_every_third_frame_is_a_sequence_of_a_third_of_the_rate(seen, online):
    third = seen.select((seen["frame"] - 1) % 3 == 0)
    numbered = third.with_features(frame=(third["frame"] - 1) // 3 + 1)
    a, b = (Tracker(online=online).track(one) for one in (third, numbered))
    assert a.frame.tolist() == (3 * (b.frame - 1) + 1).tolist()
    assert a.identity.tolist() == b.identity.tolist()
    assert np.abs(a.box - b.box).max() < 1e-6


def test_online_never_changes_what_it_said(seen):
    """The first half of a sequence gives the same links whether the second comes or not."""
    early = seen["frame"] <= 45
    features = {name: value[early] for name, value in seen.features.items()}
    part = Observations(seen.view[early], features)
    tracker = Tracker(online=True)
    a, b = tracker.associate(seen).labels[early], tracker.associate(part).labels
    assert (torch.stack([a, b]).unique(dim=1).shape[1]) == len(b.unique())
    assert len(tracker.associate(seen).stats["latency"]) == 90


def test_categories_are_never_joined_unless_asked(seen):
    kind = seen["frame"] % 2
    mixed = seen.with_features(category=kind)
    for across in (False, True):
        labels = Tracker(across_categories=across).associate(mixed).labels
        several = [len(kind[labels == k].unique()) for k in labels.unique()]
        assert (max(several) > 1) == across


def test_cameras_are_followed_apart(seen):
    two = Observations(
        torch.cat([seen.view, seen.view + 1000]),
        {name: torch.cat([value, value]) for name, value in seen.features.items()},
    ).with_features(camera=torch.arange(2).repeat_interleave(len(seen)))
    tracks = Tracker().track(two)
    assert set(np.unique(tracks.camera)) == {0, 1}
    first, second = (set(tracks.identity[tracks.camera == k]) for k in (0, 1))
    assert not first & second
    assert len(first) == len(second)


def test_a_known_path_of_the_camera_is_used():
    scene = replace(SCENE, pan=12.0, clutter=0.0)
    simulated = Simulated(scene, 2)
    seen, path = simulated.load(), simulated.camera_path
    middle = np.array([960.0, 540.0])
    transform = np.zeros((scene.frames, 2, 3))
    transform[:, 0, 0] = transform[:, 1, 1] = 1 / path[:, 0]
    transform[:, :, 2] = middle - (middle + path[:, 1:]) / path[:, :1]
    frames = np.arange(1, scene.frames + 1)
    known = CameraPath(np.zeros(scene.frames, dtype=int), frames, transform)
    answer = Tracker(camera=known).associate(seen)
    found = answer.stats["measured"][0]
    scale = path[1:, 0] / path[:-1, 0]
    shift = path[1:, 1:] - scale[:, None] * path[:-1, 1:] + (1 - scale)[:, None] * middle
    assert found.camera[1:, 0] == pytest.approx(scale)
    assert found.camera[1:, 1:] * found.unit == pytest.approx(shift, abs=1e-6)


def test_a_path_is_read_from_a_file(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("1,1,0,0,0,1,0\n2,1,0,5,0,1,-3\n")
    path = CameraPath.load(file)
    assert path.transform[1, :, 2].tolist() == [5, -3]
    file.write_text("1,1,0,0,0,1,0\n2,0,0,5,0,0,-3\n")
    with pytest.raises(ValueError, match=r"line 2: the matrix cannot be inverted"):
        CameraPath.load(file)


def test_further_modalities_are_scorers(seen):
    """Positions that tell everything apart make links that boxes alone do not."""
    place = torch.stack(
        [seen["identity"].double() * 50, seen["frame"].double() * 0, seen["frame"].double() * 0], 1
    )
    told = seen.with_features(position=place.float())
    plain = Tracker(joining=Joining(longest_gap=0)).associate(told)
    more = Tracker(joining=Joining(longest_gap=0), scorers=[Proximity()]).associate(told)
    assert more.num_clusters <= plain.num_clusters
    with pytest.raises(KeyError, match="position"):
        Tracker(scorers=[Proximity()]).associate(seen)
    with pytest.raises((KeyError, ValueError), match="images"):
        Tracker(scorers=[Color()]).associate(seen)


@pytest.mark.parametrize("online", [False, True])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_next_to_nothing(seen, count, online):
    features = {name: value[:count] for name, value in seen.features.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tracker = Tracker(online=online, frame_rate=25)
        tracks = tracker.track(Observations(seen.view[:count], features))
    assert len(tracks) <= count


def test_a_warning_where_everything_is_clutter(seen):
    with pytest.warns(UserWarning, match="no track"):
        assert not len(Tracker(Linking(birth_odds=50.0)).track(seen))


def test_boxes_that_were_not_measured_are_on_no_track(seen):
    box = seen["box"].clone()
    box[::7] = torch.nan
    tracks = Tracker().track(seen.with_features(box=box))
    assert not set(tracks.observation) & set(range(0, len(seen), 7))


def test_errors_name_what_is_wrong(seen):
    with pytest.raises(ValueError, match="frame_rate: expected a positive number, got 0"):
        Tracker(frame_rate=0)
    without = {name: value for name, value in seen.features.items() if name != "time"}
    with pytest.raises(ValueError, match=r"frame_rate.*Tracker\(frame_rate=30\)"):
        Tracker().track(Observations(seen.view, without))
    assert len(Tracker(frame_rate=25).track(Observations(seen.view, without)))
    box = seen["box"].clone()
    box[3] = box[3, [2, 3, 0, 1]]
    with pytest.raises(ValueError, match="box: expected x1 < x2"):
        Tracker().track(seen.with_features(box=box))
    with pytest.raises(ValueError, match="frame_rate"):
        Tracker().update(None)
    with pytest.raises(FileNotFoundError, match="absent"):
        Tracker(weights="absent.safetensors")
