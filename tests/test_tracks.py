import numpy as np
import pytest
import torch

from mixer_torch.observations import Observations
from mixer_torch.tracking import Tracks

NAMES = ("frame", "identity", "box", "confidence", "camera", "observation")


def boxes(n):
    return np.arange(4.0 * n).reshape(n, 4)


def test_rows_are_in_order_of_frame_then_identity():
    tracks = Tracks([3, 1, 3, 1], [1, 9, 2, 4], boxes(4), [0.1, 0.2, 0.3, 0.4])
    assert tracks.frame.tolist() == [1, 1, 3, 3]
    assert tracks.identity.tolist() == [4, 9, 1, 2]
    assert tracks.confidence.tolist() == [0.4, 0.2, 0.1, 0.3]
    assert tracks.box[:, 0].tolist() == [12, 4, 0, 8]


def test_what_is_left_out_has_defaults_and_all_have_their_types():
    tracks = Tracks(np.array([1], dtype=np.int32), torch.tensor([2]), [[0, 1, 2, 3]])
    assert {name: getattr(tracks, name).dtype for name in NAMES} == {
        name: np.float64 if name in ("box", "confidence") else np.int64 for name in NAMES
    }
    assert (tracks.confidence[0], tracks.camera[0], tracks.observation[0]) == (1, 0, -1)


def test_views_that_are_not_writable_or_run_backwards_are_fine():
    tracks = Tracks(np.broadcast_to(3, 2), np.arange(1, 3)[::-1], boxes(2)[::-1])
    assert tracks.frame.tolist() == [3, 3]
    assert tracks.box[:, 0].tolist() == [0, 4]
    tracks.box[0] = 7


def test_inputs_are_copied():
    frame, box = np.array([1, 2]), boxes(2)
    tracks = Tracks(frame, [1, 1], box)
    frame[0], box[0] = 7, -1
    assert tracks.frame.tolist() == [1, 2]
    assert tracks.box[0].tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("nothing", [[], np.empty(0), torch.empty(0)])
def test_no_rows(nothing):
    tracks = Tracks(nothing, nothing, nothing)
    assert len(tracks) == 0
    assert tracks.box.shape == (0, 4)
    assert len(tracks.select(tracks.identity == 1)) == 0
    assert len(tracks.select([])) == 0


def test_select_by_mask_and_by_index():
    tracks = Tracks([1, 1, 2], [1, 2, 1], boxes(3), camera=[5, 5, 6], observation=[7, 8, 9])
    some = tracks.select(tracks.identity == 1)
    assert some.frame.tolist() == [1, 2]
    assert some.camera.tolist() == [5, 6]
    assert some.observation.tolist() == [7, 9]
    assert tracks.select([2, 0]).observation.tolist() == [7, 9]
    with pytest.raises(ValueError, match=r"mask: expected shape \(3,\), got \(2,\)"):
        tracks.select(np.array([True, False]))


def test_one_identity_may_be_in_two_cameras_at_a_time_but_not_twice_in_one():
    tracks = Tracks([1, 1], [3, 3], boxes(2), camera=[1, 0])
    assert tracks.camera.tolist() == [0, 1]
    with pytest.raises(ValueError, match="got two of 3 in frame 1 of camera 4"):
        Tracks([1, 1], [3, 3], boxes(2), camera=[4, 4])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frame": [1.5, 2]}, "frame: expected integers"),
        ({"identity": [1, 2, 3]}, r"identity: expected shape \(2,\), got \(3,\)"),
        ({"identity": [0, 2]}, "identity: expected 1 or more, got 0"),
        ({"box": boxes(2)[:, :3]}, r"box: expected shape \(2, 4\), got \(2, 3\)"),
        ({"box": [[0, 0, 1, np.nan]] * 2}, "box: expected finite numbers"),
        ({"box": "boxes"}, "box: expected numbers"),
        ({"confidence": [1]}, "confidence: expected shape"),
        ({"observation": [True, False]}, "observation: expected integers"),
    ],
)
def test_mistakes_are_named(change, message):
    given = {"frame": [1, 2], "identity": [1, 1], "box": boxes(2)} | change
    with pytest.raises(ValueError, match=message):
        Tracks(**given)


def seen(**features):
    box = torch.tensor(boxes(4), dtype=torch.float32)
    return Observations(torch.arange(4), {"box": box, "frame": torch.arange(4) + 160, **features})


def test_labels_become_identities_that_count_from_one():
    tracks = Tracks.from_labels(seen(confidence=torch.tensor([1, 0.5, torch.nan, 0])), [2, 0, 0, 1])
    assert tracks.identity.tolist() == [3, 1, 1, 2]
    assert tracks.observation.tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(tracks.confidence, [1, 0.5, np.nan, 0])
    assert Tracks.from_labels(seen(), torch.zeros(4, dtype=torch.int64)).confidence.sum() == 4


def test_negative_labels_and_boxes_not_measured_are_left_out():
    observations = seen(camera=torch.tensor([4, 5, 6, 7]))
    observations["box"][1] = torch.nan
    tracks = Tracks.from_labels(observations, torch.tensor([0, 0, -1, 0]))
    assert tracks.observation.tolist() == [0, 3]
    assert tracks.camera.tolist() == [4, 7]
    assert tracks.frame.tolist() == [160, 163]


def test_labels_that_do_not_fit_are_named():
    with pytest.raises(ValueError, match="labels: expected 4, got 3"):
        Tracks.from_labels(seen(), [0, 1, 2])
    with pytest.raises(KeyError, match="no feature 'box'"):
        Tracks.from_labels(Observations(torch.tensor([0])), [0])
    with pytest.raises(ValueError, match="got two of 1 in frame 7"):
        Tracks.from_labels(seen(frame=torch.full((4,), 7)), [0, 0, 1, 2])
