"""From the image to the ground: where a foot point in pixels stands, in metres."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float, Float64

from mixer_torch.datasets.fitted_ground import fit_homography, is_truth
from mixer_torch.extras import require
from mixer_torch.io.files import check_file, read_json, read_text

MILLIMETRES = 1000.0
# On PETS09-S2L1 the true boxes land 3.8 cm (median) from their true ground positions; 12 cm
# without this shift.
FIRST_PIXEL = 1.0
ORTHOGONAL = 1e-3
"""How far R Rᵀ may be from the unit matrix; files print few digits."""
LENSES = (0, 4, 5, 8, 12, 14)
"""Numbers of distortion coefficients that OpenCV knows."""
FOLDER, HOMOGRAPHY = "calib", "homography.txt"


@dataclass(frozen=True)
class Homography:
    """The plane-to-plane map (x, y, 1) ~ H (u, v, 1), from pixels to metres on the ground.

    Args:
        matrix: (3, 3) H, of any scale and sign. Image rows grow downwards and the ground lies
            under the horizon, the line on which the third row of H gives 0.
    """

    matrix: Float64[np.ndarray, "3 3"]

    @classmethod
    def from_text(cls, path: str | Path) -> Homography:
        """Read three lines of three numbers, apart by spaces or commas.

        Raises:
            ValueError: The file holds anything else, or a matrix without inverse.
        """
        words = read_text(Path(path)).replace(",", " ").split()
        try:
            matrix = np.array(words, dtype=np.float64).reshape(3, 3)
        except ValueError as error:
            raise ValueError(f"{path}: expected 3 lines of 3 numbers, got {words[:12]}") from error
        if not (np.isfinite(matrix).all() and np.linalg.matrix_rank(matrix) == 3):
            raise ValueError(f"{path}: expected an invertible matrix, got {matrix.tolist()}")
        return cls(matrix)

    def to_ground(self, points: Float[np.ndarray, "m 2"]) -> np.ndarray:
        """Ground x, y in metres of image points in pixels; NaN for points above the horizon."""
        x, y, w = self.matrix @ np.column_stack([points, np.ones(len(points))]).T
        below = np.sign(self.matrix[2, 1] or self.matrix[2, 2])
        w = np.where(w * below > 0, w, np.nan)
        return np.column_stack([x / w, y / w])


@dataclass(frozen=True)
class Tsai:
    """Tsai's camera with radial distortion, as in the calibration files of PETS 2009.

    A world point p goes to the camera frame as R p + t with R = Rz Ry Rx, then by the focal
    length to ideal sensor coordinates (xu, yu), which the lens draws in to (xd, yd) with
    (xu, yu) = (1 + kappa1 (xd² + yd²)) (xd, yd). The pixel is (sx xd / dpx + cx, yd / dpy + cy),
    counting from 0, while tables of MOTChallenge, whose points this takes, count from 1.
    The field names are those of the file: lengths in millimetres, angles in radians, centre in
    pixels, ``dpx`` and ``dpy`` in millimetres per pixel, ``kappa1`` in 1 / mm².

    Source: R. Y. Tsai, "A versatile camera calibration technique for high-accuracy 3D machine
    vision metrology", IEEE Journal of Robotics and Automation, 1987.
    """

    focal: float
    kappa1: float
    cx: float
    cy: float
    sx: float
    dpx: float
    dpy: float
    tx: float
    ty: float
    tz: float
    rx: float
    ry: float
    rz: float

    @classmethod
    def from_xml(cls, path: str | Path) -> Tsai:
        """Read the attributes of ``Geometry``, ``Intrinsic`` and ``Extrinsic``.

        Raises:
            ValueError: The file is not XML, or an attribute is missing or not a number.
        """
        try:
            root = ElementTree.parse(path).getroot()
        except ElementTree.ParseError as error:
            raise ValueError(f"{path} is not readable as XML: {error}") from error
        have: dict[str, Any] = {}
        for element in root.iter():
            have |= element.attrib
        values = {}
        for name in (field.name for field in fields(cls)):
            try:
                values[name] = float(have[name])
            except KeyError:
                raise ValueError(
                    f"{path}: attribute {name!r} of the Tsai camera is missing"
                ) from None
            except ValueError:
                raise ValueError(
                    f"{path}: attribute {name!r}: expected a number, got {have[name]!r}"
                ) from None
        return cls(**values)

    def rotation(self) -> np.ndarray:
        """R = Rz Ry Rx, from world to camera."""
        (cx, sx), (cy, sy), (cz, sz) = (
            (np.cos(angle), np.sin(angle)) for angle in (self.rx, self.ry, self.rz)
        )
        x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        return z @ y @ x

    def to_ground(self, points: Float[np.ndarray, "m 2"]) -> np.ndarray:
        """Where the ray through each pixel meets z = 0, metres; NaN where it does not."""
        points = np.asarray(points, dtype=np.float64)
        distorted = (points - FIRST_PIXEL - (self.cx, self.cy)) * (self.dpx / self.sx, self.dpy)
        ideal = distorted * (1 + self.kappa1 * (distorted**2).sum(1, keepdims=True))
        rotation = self.rotation()
        ray = np.column_stack([ideal, np.full(len(ideal), self.focal)]) @ rotation
        centre = -np.array([self.tx, self.ty, self.tz]) @ rotation
        return _meet_ground(centre, ray) / MILLIMETRES


@dataclass(frozen=True)
class Pinhole:
    """The pinhole camera (u, v, 1) ~ K (R p + t), with the lens of OpenCV.

    A world point p, in metres with z upwards and the ground at z = 0, is R p + t in the camera,
    whose z points forwards and y down; the camera's centre is -Rᵀ t.

    Args:
        intrinsics: (3, 3) K, focal lengths and principal point in pixels.
        rotation: (3, 3) R, from world to camera.
        translation: (3,) t, metres.
        distortion: k1, k2, p1, p2 and so on, in the order of OpenCV; none for an ideal lens.

    Raises:
        ValueError: A number is not finite, K is not a matrix of intrinsics, or R no rotation.
    """

    intrinsics: Float64[np.ndarray, "3 3"]
    rotation: Float64[np.ndarray, "3 3"]
    translation: Float64[np.ndarray, " 3"]
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        matrix, rotation = self.intrinsics, self.rotation
        for name, value in (("K", matrix), ("R", rotation), ("t", self.translation)):
            if not np.isfinite(value).all():
                raise ValueError(f"{name}: expected finite numbers, got {value.tolist()}")
        upper = not np.tril(matrix, -1).any() and matrix[2, 2] == 1
        if not (upper and matrix[0, 0] > 0 and matrix[1, 1] > 0):
            raise ValueError(
                "K: expected [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with positive focal "
                f"lengths, got {matrix.tolist()}"
            )
        right_handed = np.linalg.det(rotation) > 0
        if not (right_handed and np.allclose(rotation @ rotation.T, np.eye(3), atol=ORTHOGONAL)):
            raise ValueError(f"R: expected a rotation, got {rotation.tolist()}")
        if len(self.distortion) not in LENSES or not np.isfinite(self.distortion).all():
            raise ValueError(
                f"distortion: expected {LENSES} finite numbers, got {list(self.distortion)}"
            )
        if self.distortion and matrix[0, 1]:
            raise ValueError(f"K: expected no skew beside distortion, got {matrix.tolist()}")

    @classmethod
    def from_json(cls, path: str | Path) -> Pinhole:
        """Read an object of ``K``, ``R``, ``t`` or ``centre``, and maybe ``distortion``.

        Raises:
            ValueError: The file is not JSON, a key is missing or unknown, or a value malformed.
        """
        found = read_json(Path(path))
        keys = set(found) if isinstance(found, dict) else set()
        if keys - {"distortion"} not in ({"K", "R", "t"}, {"K", "R", "centre"}):
            have = ", ".join(sorted(keys)) or "none"
            raise ValueError(
                f"{path}: expected keys K, R and t or centre, and maybe distortion; keys: {have}"
            )
        try:
            matrix, rotation = (_array(key, found[key], (3, 3)) for key in ("K", "R"))
            if "centre" in found:
                translation = -rotation @ _array("centre", found["centre"], (3,))
            else:
                translation = _array("t", found["t"], (3,))
            distortion = np.asarray(found.get("distortion", []), dtype=np.float64).ravel()
            return cls(matrix, rotation, translation, tuple(distortion.tolist()))
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: {error}") from None

    @classmethod
    def from_mat(cls, path: str | Path, name: str | None = None) -> Pinhole:
        """Read one camera of the struct array ``cam_param`` of the CAMPUS data set.

        Its ``T`` is the camera's centre, in metres; the pixel is K R (p - T), divided by its third
        coordinate, plus ``center``.

        Source: Y. Xu et al., "Multi-view people tracking via hierarchical trajectory
        composition", CVPR 2016, whose data have this file.

        Args:
            path: MATLAB file.
            name: The camera's ``name``; not needed where there is one.

        Raises:
            ValueError: The file is malformed, or has no camera of that name.
        """
        camera = _mat_camera(Path(path), name)
        try:
            matrix, rotation = (_array(key, camera[key], (3, 3)).copy() for key in ("K", "R"))
            centre = _array("T", camera["T"].ravel(), (3,))
            matrix[:2, 2] += _array("center", camera["center"].ravel(), (2,))
            if (camera["scale"] != 1).any():
                raise ValueError(f"scale: expected 1, got {camera['scale'].tolist()}")
            return cls(matrix, rotation, -rotation @ centre)
        except ValueError as error:
            raise ValueError(f"{path}: camera {name!r}: {error}") from None

    @property
    def centre(self) -> Float64[np.ndarray, " 3"]:
        """Where the camera is, world, metres."""
        return -self.rotation.T @ self.translation

    def to_ground(self, points: Float[np.ndarray, "m 2"]) -> np.ndarray:
        """Where the ray through each pixel meets z = 0, metres; NaN where it does not."""
        points = np.asarray(points, dtype=np.float64)
        if self.distortion and len(points):
            cv2 = require("cv2", extra="vision")

            lens = np.array(self.distortion)
            points = cv2.undistortPoints(points[:, None], self.intrinsics, lens)[:, 0]
            ray = np.column_stack([points, np.ones(len(points))])
        else:
            ray = np.column_stack([points, np.ones(len(points))])
            ray = ray @ np.linalg.inv(self.intrinsics).T
        return _meet_ground(self.centre, ray @ self.rotation)


def _meet_ground(centre: Float64[np.ndarray, " 3"], ray: Float64[np.ndarray, "m 3"]) -> np.ndarray:
    """Where rays from a centre meet z = 0, in the unit of the centre; NaN where they do not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        along = -centre[2] / ray[:, 2]
    along = np.where(np.isfinite(along) & (along > 0), along, np.nan)
    return centre[:2] + along[:, None] * ray[:, :2]


def _array(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected numbers, got {value!r}") from None
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {array.tolist()}")
    return array


def _mat_camera(path: Path, name: str | None) -> dict[str, Any]:
    """The fields of one camera of a struct array ``cam_param``, as arrays of float64."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        cameras = np.ravel(loadmat(path)["cam_param"])
        named = {str(np.ravel(camera["name"])[0]): camera for camera in cameras}
    except (MatReadError, ValueError, TypeError, IndexError) as error:
        raise ValueError(f"{path} is not readable as a file of cameras: {error}") from error
    except KeyError as error:
        raise ValueError(f"{path}: {error} is missing; expected cam_param with names") from None
    if name is None and len(named) == 1:
        name = next(iter(named))
    if name not in named:
        raise ValueError(f"{path}: name: expected one of {', '.join(named)}, got {name!r}")
    try:
        return {
            field: np.asarray(named[name][field], dtype=np.float64)
            for field in ("K", "R", "T", "scale", "center")
        }
    except ValueError as error:
        raise ValueError(f"{path}: camera {name!r}: {error}") from None


Calibration = Homography | Tsai | Pinhole


def read_calibration(path: str | Path, name: str | None = None) -> Calibration:
    """A Tsai camera from ``.xml``, a pinhole from ``.json`` or ``.mat``, else a homography.

    A homography is nine numbers, or is fitted to a table of truth with ground positions
    (:func:`~mixer_torch.datasets.fitted_ground.fit_homography`).

    Args:
        path: The file.
        name: The camera, in a ``.mat`` file of several.

    Raises:
        OSError: There is no such file, or it is a folder.
        ValueError: It is malformed, or has no camera of that name.
    """
    path = Path(path)
    check_file(path, "calibration ")
    suffix = path.suffix.lower()
    if suffix == ".mat":
        return Pinhole.from_mat(path, name)
    if name is not None:
        raise ValueError(f"name: {path} has one camera and no names, got {name!r}")
    if suffix == ".json":
        return Pinhole.from_json(path)
    if suffix == ".xml":
        return Tsai.from_xml(path)
    return Homography(fit_homography(path)) if is_truth(path) else Homography.from_text(path)


def find_calibration(folder: Path) -> Calibration | None:
    """The calibration of a sequence: ``calib/*.xml`` or ``homography.txt``, None without either.

    Raises:
        ValueError: There is more than one, or it is malformed.
    """
    files = sorted((folder / FOLDER).glob("*.xml"))
    files += [path for path in [folder / HOMOGRAPHY] if path.is_file()]
    if len(files) > 1:
        names = ", ".join(str(path.relative_to(folder)) for path in files)
        raise ValueError(f"{folder}: expected one calibration, got {names}; name the one to use")
    return read_calibration(files[0]) if files else None
