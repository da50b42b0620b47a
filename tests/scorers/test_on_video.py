"""What the scorers see in real video: how well each tells the same from strangers."""

import pytest
from sklearn.metrics import roc_auc_score

import mixer_torch as mx
from mixer_torch.datasets.landmarks import Landmarks
from mixer_torch.datasets.motchallenge import MOTChallenge
from mixer_torch.scorers import SIFT, Color, IoU, Proximity, SIFTAtPoints

pytestmark = pytest.mark.real_data


def same_of(observations, pairs):
    a, b = observations["identity"][pairs]
    return (a == b) & (a >= 0)


@pytest.fixture(scope="module")
def walkers():
    """PETS, frames 160 to 780, every 20th: pairs of neighbouring views, people 2.9 s apart."""
    observations = MOTChallenge("mot15/PETS09-S2L1", start=160, stop=780, step=20).load()
    pairs = mx.Within(20.0)(observations)
    return observations, pairs, same_of(observations, pairs)


@pytest.mark.parametrize(
    ("scorer", "least"),
    [
        (IoU(max_gap=20.0), 0.50),
        (Proximity(1.0, 5.0, 1.5), 0.85),
        (Color("histogram"), 0.93),
        (SIFT(), 0.80),
    ],
    ids=lambda value: value.name if hasattr(value, "name") else None,
)
def test_people_are_told_apart(walkers, scorer, least):
    observations, pairs, same = walkers
    assert roc_auc_score(same, scorer(observations, pairs)) > least


def test_strangers_are_not_taken_for_the_same(walkers):
    # A score over 0.5 claims that the evidence speaks for the same; strangers are to be rare there.
    observations, pairs, same = walkers
    for scorer, most in ((Color("histogram"), 0.15), (SIFT(), 0.35)):
        claimed = scorer(observations, pairs)[~same] > 0.5
        assert float(claimed.float().mean()) < most


@pytest.mark.parametrize(("gap", "least"), [(10, 0.99), (30, 0.95), (60, 0.8)])
def test_landmarks_are_found_again(gap, least):
    observations = Landmarks("cmu_hotel", step=10).load()
    pairs = mx.Every()(observations)
    frame = observations["frame"]
    pairs = pairs[:, (frame[pairs[0]] - frame[pairs[1]]).abs() == gap]
    same = same_of(observations, pairs)
    found = SIFTAtPoints()(observations, pairs) > 0.5
    assert float(found[same].float().mean()) >= least
    assert float(found[~same].float().mean()) < 0.01


def test_proximity_of_points_in_the_picture():
    observations = Landmarks("cmu_hotel", step=10).load()
    pairs = mx.Within(20.0)(observations)
    score = Proximity(scale=10.0, memory=20.0, speed=1.0, feature="point")(observations, pairs)
    same = same_of(observations, pairs)
    assert roc_auc_score(same, score) > 0.99
    assert float((score[same] > 0.5).float().mean()) > 0.95
