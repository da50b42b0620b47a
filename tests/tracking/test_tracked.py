"""Tracked: which tracklet of the whole video each observation of sparse frames is of."""

import pytest
import torch

from mixer_torch.datasets.base import Dataset
from mixer_torch.observations import Observations
from mixer_torch.pairs import Every
from mixer_torch.scorers import Motion, Tracklet
from mixer_torch.scoring import score
from mixer_torch.tracking import Tracker
from mixer_torch.tracking.tracked import Tracked, places
from mixer_torch.tracking.tracklets import TRACKLET_FEATURES


class Kept(Dataset):
    """Observations that are there already."""

    def __init__(self, observations):
        self.observations = observations

    def load(self):
        return self.observations


def walkers(frames=61, missing=range(0)):
    """Three who walk, 7 frames a second, 300 pixels apart; in some frames one is not seen."""
    generator = torch.Generator().manual_seed(0)
    frame = torch.arange(1, frames + 1).repeat_interleave(3)
    who = torch.arange(3).repeat(frames)
    x = 300.0 * who + 4.0 * frame + torch.randn(len(frame), generator=generator)
    box = torch.stack([x - 20, 0 * x, x + 20, 0 * x + 100], 1)
    features = {"frame": frame, "time": (frame - 1) / 7, "box": box, "identity": who}
    gone = (who == 2) & torch.isin(frame, torch.tensor(list(missing), dtype=torch.int64))
    return Observations(frame, features).select((~gone).nonzero()[:, 0])


def sparse(video, step=20):
    return video.select(((video["frame"] - 1) % step == 0).nonzero()[:, 0])


def tracked(video, observed=None):
    observed = sparse(video) if observed is None else observed
    tracker = Tracker([Motion()], [], gaps=())
    return Tracked(Kept(observed), Kept(video), tracker).load()


def test_one_tracklet_a_walker():
    seen = tracked(walkers())
    assert len(seen) == 12
    for who in range(3):
        rows = (seen["identity"] == who).nonzero()[:, 0]
        assert len(seen["tracklet"][rows].unique()) == 1
        torch.testing.assert_close(
            seen["tracklet_span"][rows], torch.tensor([[0.0, 60 / 7]]).double().expand(4, 2)
        )
    assert len(seen["tracklet"].unique()) == 3


def test_who_is_lost_for_long_has_two_tracklets_and_the_second_continues_the_first():
    seen = tracked(walkers(missing=range(22, 36)))
    rows = (seen["identity"] == 2).nonzero()[:, 0]
    before, after = seen["tracklet"][rows[:2]], seen["tracklet"][rows[2:]]
    assert before[0] == before[1] != after[0] == after[1]
    assert float(seen["tracklet_span"][rows[0], 1]) == pytest.approx(20 / 7)
    assert float(seen["tracklet_span"][rows[3], 0]) == pytest.approx(35 / 7)
    pairs = Every()(seen)
    scores = score(seen, [Tracklet()], pairs).scores[0]
    same = seen["identity"][pairs[0]] == seen["identity"][pairs[1]]
    assert float(scores[same].min()) > 0.5 > float(scores[~same].max())


def test_what_was_observed_stays_and_its_order_is_no_matter():
    video = walkers(missing=range(22, 36))
    observed = sparse(video)
    order = torch.randperm(len(observed), generator=torch.Generator().manual_seed(1))
    there, moved = tracked(video), tracked(video, observed.select(order))
    for name in (*observed.features, *TRACKLET_FEATURES):
        torch.testing.assert_close(moved[name], there[name][order], rtol=0, atol=0)
    assert set(there.features) == {*observed.features, *TRACKLET_FEATURES}


def test_nothing_observed():
    video = walkers()
    seen = tracked(video, video.select(torch.zeros(0, dtype=torch.int64)))
    assert len(seen) == 0
    assert seen["tracklet"].shape == (0,)


def test_the_same_box_twice_has_two_places():
    video = walkers(frames=2).select(torch.tensor([0, 1, 1, 2]))
    assert places(video.select(torch.tensor([2, 0, 1])), video).tolist() == [1, 0, 2]


def test_what_is_not_in_the_video_is_named():
    video = walkers()
    with pytest.raises(ValueError, match=r"video: expected all .*no box .* in frame 61"):
        tracked(video.select((video["frame"] < 61).nonzero()[:, 0]), sparse(video))
