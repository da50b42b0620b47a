"""The pinhole camera: OpenCV's projections come back, and malformed files are named."""

import json

import cv2
import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from mixer_torch.datasets.calibration import Pinhole, read_calibration

K = np.array([[1200.0, 0, 950], [0, 1180, 530], [0, 0, 1]])
CENTRE = np.array([3.0, -2.0, 4.0])
# Camera axes in the world, as rows: x to the east, y down, z to the north, then tilted down.
LEVEL = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
R = Rotation.from_euler("xyz", [0.4, 0.1, 0.2]).as_matrix() @ LEVEL
GROUND = np.array([[3.0, 4.0], [1.0, 7.5], [5.5, 6.0], [4.0, 15.0]])


def project(ground, distortion=()):
    world = np.column_stack([ground, np.zeros(len(ground))])
    vector = cv2.Rodrigues(R)[0]
    pixels, _ = cv2.projectPoints(world, vector, -R @ CENTRE, K, np.array(distortion))
    return pixels[:, 0]


def camera(**changes):
    return {"K": K.tolist(), "R": R.tolist(), "t": (-R @ CENTRE).tolist()} | changes


def written(folder, content):
    file = folder / "camera.json"
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    return file


def cam_param(folder, **changes):
    dtype = [(name, object) for name in ("name", "K", "R", "T", "scale", "center")]
    matrix = np.diag([1200.0, 1180, 1])
    fields = {"K": matrix, "R": R, "T": CENTRE[:, None], "scale": 1, "center": K[:2, 2][None]}
    cameras = np.empty(2, dtype=dtype)
    for k, name in enumerate(("left", "right")):
        cameras[k] = tuple(({"name": name} | fields | changes)[field] for field, _ in dtype)
    cameras[0]["T"] = np.zeros((3, 1))
    savemat(folder / "cameras.mat", {"cam_param": cameras})
    return folder / "cameras.mat"


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 1e-3, -1e-3), (0.1, 0, 0, 0, 0.01)])
def test_projected_points_come_back(tmp_path, distortion):
    file = written(tmp_path, camera(distortion=list(distortion)))
    ground = read_calibration(file).to_ground(project(GROUND, distortion))
    # OpenCV takes the lens out by a few iterations.
    np.testing.assert_allclose(ground, GROUND, atol=0.01 if distortion else 1e-9)


def test_centre_in_place_of_translation(tmp_path):
    content = camera(centre=CENTRE.tolist())
    del content["t"]
    found = read_calibration(written(tmp_path, content))
    np.testing.assert_allclose(found.centre, CENTRE)
    np.testing.assert_allclose(found.to_ground(project(GROUND)), GROUND, atol=1e-9)


def test_above_the_horizon_is_nan():
    found = Pinhole(K, LEVEL, -LEVEL @ CENTRE)
    # Level, so the horizon is the row of the principal point.
    ground = found.to_ground(np.array([[950.0, 529.0], [950.0, 530.0], [950.0, 531.0]]))
    assert np.isnan(ground[:2]).all()
    np.testing.assert_allclose(ground[2], [3.0, -2.0 + 4 * 1180], atol=1e-6)


@pytest.mark.parametrize("distortion", [(), (0.1, 0.0, 0.0, 0.0)])
def test_no_points(distortion):
    found = Pinhole(K, R, -R @ CENTRE, distortion)
    assert found.to_ground(np.empty((0, 2))).shape == (0, 2)


def test_cameras_of_a_mat_file(tmp_path):
    file = cam_param(tmp_path)
    found = read_calibration(file, "right")
    np.testing.assert_allclose(found.centre, CENTRE)
    np.testing.assert_allclose(found.to_ground(project(GROUND)), GROUND, atol=1e-9)
    np.testing.assert_allclose(read_calibration(file, "left").centre, 0, atol=1e-12)
    for name in ("middle", None):
        with pytest.raises(ValueError, match="expected one of left, right, got") as caught:
            read_calibration(file, name)
        assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"R": np.ones((3, 3))}, "camera 'right': R: expected a rotation"),
        ({"K": np.eye(2)}, r"K: expected shape \(3, 3\), got \(2, 2\)"),
        ({"scale": 2.0}, "scale: expected 1"),
        ({"T": np.full((3, 1), np.inf)}, "T: expected finite numbers"),
        ({"center": "middle"}, "camera 'right'"),
    ],
)
def test_mat_file_malformed(tmp_path, changes, message):
    file = cam_param(tmp_path, **changes)
    with pytest.raises(ValueError, match=message) as caught:
        read_calibration(file, "right")
    assert str(file) in str(caught.value)


def test_mat_file_of_something_else(tmp_path):
    savemat(tmp_path / "a.mat", {"other": 1})
    with pytest.raises(ValueError, match="'cam_param' is missing"):
        read_calibration(tmp_path / "a.mat")
    (tmp_path / "b.mat").write_bytes(b"no mat file at all" * 20)
    with pytest.raises(ValueError, match="not readable as a file of cameras"):
        read_calibration(tmp_path / "b.mat")
    savemat(tmp_path / "c.mat", {"cam_param": 3.0})
    with pytest.raises(ValueError, match="not readable as a file of cameras"):
        read_calibration(tmp_path / "c.mat")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not readable as JSON"),
        ([1], "keys: none"),
        ({"K": 1, "R": 2}, "expected keys K, R and t or centre.*keys: K, R"),
        (camera(skew=0), "keys: K, R, skew, t"),
        (camera(t=[1, 2]), r"t: expected shape \(3,\), got \(2,\)"),
        (camera(K="wide"), "K: expected numbers, got 'wide'"),
        (camera(K=np.diag([1200, -1, 1]).tolist()), "K: expected .* positive focal lengths"),
        (camera(R=(-R).tolist()), "R: expected a rotation"),
        (
            camera(K=[[1200, 1, 950], [0, 1180, 530], [0, 0, 1]], distortion=[0.1, 0, 0, 0]),
            "K: expected no skew",
        ),
        (camera(distortion=[0.1]), "distortion: expected .* finite numbers"),
    ],
)
def test_json_malformed(tmp_path, content, message):
    file = written(tmp_path, content)
    with pytest.raises(ValueError, match=message) as caught:
        read_calibration(file)
    assert str(file) in str(caught.value)


def test_a_file_of_one_camera_has_no_names(tmp_path):
    with pytest.raises(ValueError, match="has one camera and no names, got 'left'"):
        read_calibration(written(tmp_path, camera()), "left")
