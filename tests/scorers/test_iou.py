"""IoU: values worked by hand, and when it speaks."""

import pytest
import torch

from mixer_torch.boxes import paired_iou
from mixer_torch.observations import Observations
from mixer_torch.pairs import Every
from mixer_torch.scorers import IoU


def boxes(*rows):
    return torch.tensor(rows, dtype=torch.float32)


def test_overlap_by_hand():
    box = boxes((0, 0, 2, 2), (1, 1, 3, 3), (2, 0, 4, 2), (0, 0, 2, 2), (0, 0, 4, 4), (5, 5, 5, 5))
    pairs = torch.tensor([[0, 0, 0, 0, 0, 5], [1, 2, 3, 4, 5, 5]])
    # A corner of 1 of 4 + 4 - 1; an edge in common; itself; 4 inside 16; no area at all.
    expected = torch.tensor([1 / 7, 0.0, 1.0, 0.25, 0.0, 0.0])
    torch.testing.assert_close(paired_iou(*box[pairs]), expected)


def test_gradient_of_overlap():
    box = torch.tensor([[0, 0, 2, 2], [0.5, 0.7, 3, 3.1]], dtype=torch.float64, requires_grad=True)
    pairs = torch.tensor([[0], [1]])
    assert torch.autograd.gradcheck(lambda box: paired_iou(*box[pairs]), (box,))


def seen(frame, camera=None, time=None):
    m = len(frame)
    features = {"frame": torch.tensor(frame), "box": boxes((0, 0, 2, 2)).expand(m, 4).clone()}
    if camera is not None:
        features["camera"] = torch.tensor(camera)
    if time is not None:
        features["time"] = torch.tensor(time)
    return Observations(torch.arange(m), features)


def score(scorer, observations):
    return scorer(observations, Every()(observations)).tolist()


def test_only_consecutive_views_are_compared():
    assert score(IoU(2.0), seen([0, 2, 5])) == pytest.approx([0.98, 0.5, 0.5])


def test_consecutive_in_seconds():
    scorer = IoU(0.5, feature="time")
    assert score(scorer, seen([0, 9, 10], time=[0.0, 0.4, 1.0])) == pytest.approx([0.98, 0.5, 0.5])


def test_only_one_camera_is_compared():
    assert score(IoU(), seen([0, 0, 1], camera=[0, 1, 0])) == pytest.approx([0.5, 0.98, 0.5])


def test_score_set_by_hand():
    # IoU of 0, 1/10 and 0.6 and more are the three points that the arguments name.
    box = boxes((0, 0, 10, 1), (20, 0, 30, 1), (0, 0, 1, 1), (0, 0, 6, 1))
    observations = Observations(torch.arange(4), {"frame": torch.tensor([0, 1, 1, 1]), "box": box})
    pairs = torch.tensor([[0, 0, 0], [1, 2, 3]])
    scorer = IoU(disjoint=0.2, indifferent=0.1, sure=0.6, ceiling=0.9)
    assert scorer(observations, pairs).tolist() == pytest.approx([0.2, 0.5, 0.9])


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"max_gap": -1.0}, "max_gap"),
        ({"disjoint": 0.6}, "disjoint"),
        ({"ceiling": 0.4}, "ceiling"),
        ({"indifferent": 0.0}, "indifferent"),
        ({"sure": 0.05}, "sure"),
    ],
)
def test_refuses(arguments, name):
    with pytest.raises(ValueError, match=name):
        IoU(**arguments)


def test_moments_must_be_one_number_each():
    observations = seen([0, 1]).with_features(track=torch.zeros(2, 2))
    with pytest.raises(ValueError, match="feature"):
        IoU(feature="track")(observations, Every()(observations))
