"""Calibrations: projected ground points come back, and horizons are kept to."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixer_torch.boxes import corners, foot_points
from mixer_torch.datasets.calibration import (
    Homography,
    Tsai,
    find_calibration,
    read_calibration,
)
from mixer_torch.io.motchallenge import read_truth

CAMERA = Tsai(
    focal=5.5, kappa1=5e-3, cx=324.0, cy=282.0, sx=1.09, dpx=5.1e-3, dpy=4.6e-3,
    tx=829.0, ty=-3175.0, tz=35469.0, rx=2.04, ry=-0.89, rz=-0.43,
)  # fmt: skip


def project(camera, ground):
    """Forward model written apart from the library: OpenCV's rotations, roots of the cubic."""
    axes = np.diag([camera.rx, camera.ry, camera.rz])
    x, y, z = (cv2.Rodrigues(axis)[0] for axis in axes)
    world = np.column_stack([ground * 1000, np.zeros(len(ground))])
    point = world @ (z @ y @ x).T + (camera.tx, camera.ty, camera.tz)
    ideal = camera.focal * point[:, :2] / point[:, 2:]
    pixels = []
    for u in ideal:
        radius = np.linalg.norm(u)
        roots = np.roots([camera.kappa1, 0, 1, -radius])
        drawn = roots[np.isreal(roots)].real.min() if camera.kappa1 else radius
        pixels.append(u * drawn / radius)
    sensor = np.array(pixels).reshape(-1, 2)
    return np.column_stack(
        [camera.sx * sensor[:, 0] / camera.dpx + camera.cx, sensor[:, 1] / camera.dpy + camera.cy]
    ), point[:, 2]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=1, max_size=5))
def test_tsai_round_trip(ground):
    ground = np.array(ground)
    pixels, depth = project(CAMERA, ground)
    assert (depth > 0).all()
    np.testing.assert_allclose(CAMERA.to_ground(pixels + 1), ground, atol=1e-6)


def test_tsai_rotation_is_a_rotation():
    rotation = CAMERA.rotation()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_tsai_above_the_horizon_is_nan():
    sky = CAMERA.to_ground(np.array([[300.0, -2000.0], [300.0, 500.0]]))
    assert np.isnan(sky[0]).all()
    assert np.isfinite(sky[1]).all()


def test_tsai_of_no_points():
    assert CAMERA.to_ground(np.empty((0, 2))).shape == (0, 2)


@pytest.mark.parametrize("sign", [1, -1, 1e-3])
def test_homography_round_trip(tmp_path, sign):
    plane = np.array([[40.0, 10, 300], [2, -5, 200], [0.01, -0.08, 1]])
    ground = np.array([[0.0, 0], [1, 4], [-3, 2.5]])
    image = np.column_stack([ground, np.ones(3)]) @ plane.T
    image = image[:, :2] / image[:, 2:]
    np.savetxt(tmp_path / "homography.txt", sign * np.linalg.inv(plane), delimiter=",")
    homography = read_calibration(tmp_path / "homography.txt")
    np.testing.assert_allclose(homography.to_ground(image), ground, atol=1e-9)


def test_homography_above_the_horizon_is_nan():
    # Horizon at row 100: w = v - 100.
    homography = Homography(np.array([[1.0, 0, 0], [0, 0, 500], [0, 1, -100]]))
    ground = homography.to_ground(np.array([[10.0, 150.0], [10.0, 100.0], [10.0, 50.0]]))
    np.testing.assert_allclose(ground, [[0.2, 10], [np.nan] * 2, [np.nan] * 2])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n4 5 6\n", "3 lines of 3 numbers"),
        ("1 0 0\n0 one 0\n0 0 1", "3 lines of 3 numbers"),
        ("1 2 3\n2 4 6\n0 0 1", "invertible"),
        ("nan 0 0\n0 1 0\n0 0 1", "invertible"),
    ],
)
def test_homography_malformed(tmp_path, text, message):
    file = tmp_path / "homography.txt"
    file.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_calibration(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<Camera", "not readable as XML"),
        ("<Camera><Intrinsic focal='5'/></Camera>", "'kappa1'.*is missing"),
        ("<Camera><Intrinsic focal='long'/></Camera>", "'focal': expected a number, got 'long'"),
    ],
)
def test_tsai_malformed(tmp_path, text, message):
    file = tmp_path / "camera.xml"
    file.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_calibration(file)
    assert str(file) in str(caught.value)


def test_find_calibration(tmp_path):
    assert find_calibration(tmp_path) is None
    (tmp_path / "homography.txt").write_text("1 0 0\n0 1 0\n0 0 1")
    assert isinstance(find_calibration(tmp_path), Homography)
    (tmp_path / "calib").mkdir()
    (tmp_path / "calib" / "a.xml").write_text("<Camera/>")
    with pytest.raises(ValueError, match="expected one calibration"):
        find_calibration(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"nowhere\.txt"):
        read_calibration(tmp_path / "nowhere.txt")


@pytest.mark.real_data
def test_tsai_against_true_ground_positions(real_data):
    folder = real_data / "mot15" / "PETS09-S2L1"
    truth = read_truth(folder / "gt" / "gt.txt")
    ground = find_calibration(folder).to_ground(foot_points(corners(truth[:, 2:6])))
    distance = np.linalg.norm(ground - truth[:, 7:9], axis=1)
    assert np.median(distance) < 0.05
    assert distance.max() < 0.25
