"""The ground from a table of truth: a known homography comes back, and what has none is refused."""

import numpy as np
import pytest

from mixer_torch.boxes import corners, foot_points
from mixer_torch.datasets import MOTChallenge
from mixer_torch.datasets.calibration import read_calibration
from mixer_torch.io.motchallenge import read_truth

PLANE = np.array([[40.0, 10, 300], [2, -5, 200], [0.01, -0.08, 1]])
"""From metres on the ground to pixels."""
CORNERS = np.array([[0.0, 0], [4, 0], [4, 3], [-1, 5]])
LINE = np.column_stack([np.linspace(0, 5, 40), 1 + 0.5 * np.linspace(0, 5, 40)])


def seen(ground):
    """Pixels of points on the ground."""
    image = np.column_stack([ground, np.ones(len(ground))]) @ PLANE.T
    return image[:, :2] / image[:, 2:]


def truth(path, ground, foot=None, columns=10):
    """A table of boxes of 20 x 50 that stand there, one a frame, with their positions."""
    foot = seen(ground) if foot is None else foot
    count = len(ground)
    box = np.column_stack([foot[:, 0] - 10, foot[:, 1] - 50, np.tile([20, 50], (count, 1))])
    start = np.column_stack([np.arange(1, count + 1), np.full(count, 7), box, np.ones(count)])
    rows = np.column_stack([start, ground, np.zeros(count)])[:, :columns]
    np.savetxt(path, rows, delimiter=",", fmt="%.9g")
    return path


def walks(count, seed=0):
    return np.random.default_rng(seed).uniform((-4, 0), (4, 6), (count, 2))


@pytest.mark.parametrize("ground", [CORNERS, walks(50)])
def test_a_known_homography_comes_back(tmp_path, ground):
    found = read_calibration(truth(tmp_path / "gt.txt", ground))
    elsewhere = walks(20, seed=1)
    np.testing.assert_allclose(found.to_ground(seen(elsewhere)), elsewhere, atol=1e-4)


def test_noise_and_outliers(tmp_path):
    rng, ground = np.random.default_rng(0), walks(200)
    annotated = ground + rng.normal(0, 0.03, ground.shape)
    annotated[:40] += 3
    found = read_calibration(truth(tmp_path / "gt.txt", annotated, seen(ground)))
    error = np.linalg.norm(found.to_ground(seen(ground)) - ground, axis=1)
    assert error.max() < 0.05


def test_what_is_not_known_does_not_count(tmp_path):
    ground, foot = walks(30), seen(walks(30))
    ground[::3] = -1
    ground[1, 0] = -1  # a place like any other
    foot[1] = seen(ground)[1]
    found = read_calibration(truth(tmp_path / "gt.txt", ground, foot))
    np.testing.assert_allclose(found.to_ground(foot[1:3]), ground[1:3], atol=1e-4)


@pytest.mark.parametrize(
    ("ground", "columns", "message"),
    [
        (np.full((9, 2), -1.0), 10, "expected ground positions in columns 8 and 9, all are -1"),
        (walks(9), 9, "expected ground positions X, Y in columns 8 and 9 of 10, got 9 columns"),
        (CORNERS[:3], 10, "expected ground positions of 4 boxes or more, got 3"),
        (LINE, 10, "do not determine a homography"),
        (LINE + np.random.default_rng(0).normal(0, 0.02, LINE.shape), 10, "do not determine"),
        (np.concatenate([LINE[::13], CORNERS[1:2]]), 10, "do not determine a homography"),
        (np.repeat(CORNERS[:1], 6, 0), 10, "do not determine a homography"),
        (np.repeat(CORNERS[:2], 6, 0), 10, "do not determine a homography"),
    ],
)
def test_too_little_to_tell(tmp_path, ground, columns, message):
    rng = np.random.default_rng(1)
    foot = seen(ground) + (rng.normal(0, 1, ground.shape) if len(ground) == len(LINE) else 0)
    file = truth(tmp_path / "gt.txt", ground, foot, columns)
    with pytest.raises(ValueError, match=message) as caught:
        read_calibration(file)
    assert str(file) in str(caught.value)


def test_positions_that_are_nan_are_not_known(tmp_path):
    file = truth(tmp_path / "gt.txt", np.full((9, 2), np.nan), seen(walks(9)))
    with pytest.raises(ValueError, match="columns 8 and 9, all are -1 or NaN"):
        read_calibration(file)


def test_a_camera_that_moves_is_refused(tmp_path):
    ground = walks(60)
    drift = np.column_stack([np.arange(60.0), np.zeros(60)])
    file = truth(tmp_path / "gt.txt", ground + drift, seen(ground))
    with pytest.raises(ValueError, match=r"camera that stands still: .* of 60 within 0.3 m"):
        read_calibration(file)


def test_a_matrix_is_still_a_matrix(tmp_path):
    (tmp_path / "line.txt").write_text("2,0,0,0,2,0,0,0,1\n")
    place = read_calibration(tmp_path / "line.txt").to_ground(np.array([[3.0, 4.0]]))
    assert place.tolist() == [[6, 8]]


def test_positions_of_a_sequence(tmp_path):
    (tmp_path / "gt").mkdir()
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nframeRate=10\n")
    ground = walks(12)
    file = truth(tmp_path / "gt" / "gt.txt", ground)
    assert "position" not in MOTChallenge(tmp_path, source="gt").load().features
    found = MOTChallenge(tmp_path, source="gt", calibration=file).load()["position"]
    np.testing.assert_allclose(found, np.column_stack([ground, np.zeros(12)]), atol=1e-4)


@pytest.mark.real_data
def test_tud_stadtmitte(real_data):
    folder = real_data / "mot15" / "TUD-Stadtmitte"
    rows = read_truth(folder / "gt" / "gt.txt")
    place = read_calibration(folder / "gt" / "gt.txt").to_ground(foot_points(corners(rows[:, 2:6])))
    distance = np.linalg.norm(place - rows[:, 7:9], axis=1)
    assert np.median(distance) < 0.06
    assert (distance < 0.3).mean() > 0.99


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "message"), [("KITTI-17", "all are -1"), ("ETH-Bahnhof", "stands still")]
)
def test_real_tables_without_a_ground(real_data, name, message):
    with pytest.raises(ValueError, match=message):
        read_calibration(real_data / "mot15" / name / "gt" / "gt.txt")
