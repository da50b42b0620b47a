"""Where a camera looked, frame by frame, and boxes as they would be had it not moved."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from mixer_torch.io.text import read_numbers, refuse
from mixer_torch.observations import Observations
from mixer_torch.tracks import Tracks


@dataclass(frozen=True, eq=False, repr=False)
class CameraPath:
    """Similarities from the pixels of frames to coordinates in which a resting scene rests.

    Args:
        camera: (F,) int64.
        frame: (F,) int64, ascending in each camera.
        transform: (F, 2, 3) float64; a point p of the frame rests at M p + t, M being the first
            two columns and t the third.

    Raises:
        ValueError: The arrays are not of one length, or a frame is there twice.
    """

    # Any, so that the check below comes before that of shapes.
    camera: Any
    frame: Any
    transform: Any

    def __post_init__(self) -> None:
        n = len(self.frame)
        shapes = {"camera": (n,), "frame": (n,), "transform": (n, 2, 3)}
        for name, shape in shapes.items():
            if (found := np.shape(getattr(self, name))) != shape:
                raise ValueError(f"{name}: expected shape {shape}, got {found}")
        order = np.lexsort((self.frame, self.camera))
        for name in shapes:
            object.__setattr__(self, name, np.asarray(getattr(self, name))[order])
        again = (np.diff(self.camera) == 0) & (np.diff(self.frame) == 0)
        if again.any():
            raise ValueError(f"frame: expected each one once, got {self.frame[1:][again][0]} again")

    def __repr__(self) -> str:
        return f"CameraPath of {len(self)} frames"

    def __len__(self) -> int:
        return len(self.frame)

    @classmethod
    def load(cls, path: str | Path) -> CameraPath:
        """Read a path of one camera: lines of frame and the 2x3 matrix from its pixels to rest.

        Numbers are apart by commas: frame, m11, m12, m13, m21, m22, m23; lines in any order.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: A line is malformed; the message names it.
        """
        rows, number = read_numbers(Path(path), 7, delimiter=",")
        wrong = ~np.isfinite(rows).all(1)
        refuse(Path(path), number, wrong, "a number is not finite")
        frame, matrix = rows[:, 0].astype(np.int64), rows[:, 1:7].reshape(-1, 2, 3)
        flat = np.abs(np.linalg.det(matrix[:, :, :2])) < 1e-12
        refuse(Path(path), number, flat, "the matrix cannot be inverted")
        return cls(np.zeros(len(frame), dtype=np.int64), frame, matrix)

    def at(self, camera: Any, frame: Any) -> Float64[np.ndarray, "n 2 3"]:
        """The transforms at some frames of some cameras, on a line where they are in between.

        Before the first frame and after the last one, the camera rests.

        Args:
            camera: (n,) integers.
            frame: (n,) integers.

        Raises:
            ValueError: There is nothing of a camera.
        """
        camera, frame = np.asarray(camera), np.asarray(frame)
        found = np.empty((len(frame), 6))
        for one in np.unique(camera):
            known, asked = self.camera == one, camera == one
            if not known.any():
                raise ValueError(f"camera: expected one of {np.unique(self.camera)}, got {one}")
            for k, column in enumerate(self.transform[known].reshape(-1, 6).T):
                found[asked, k] = np.interp(frame[asked], self.frame[known], column)
        return found.reshape(-1, 2, 3)

    def stabilised(self, observations: Observations) -> Observations:
        """The observations with ``box`` where it rests, pixels and all other features as before."""
        frame, camera = frames_and_cameras(observations)
        transform = torch.from_numpy(self.at(camera, frame)).to(observations.device)
        box = observations["box"]
        return observations.with_features(box=moved_boxes(box.double(), transform).to(box.dtype))

    def steadied(self, tracks: Tracks) -> Tracks:
        """The tracks with boxes where they rest."""
        return _with_boxes(tracks, self.at(tracks.camera, tracks.frame))

    def restored(self, tracks: Tracks) -> Tracks:
        """The tracks with boxes in the pixels of their frames: :meth:`steadied` undone."""
        return _with_boxes(tracks, inverse(self.at(tracks.camera, tracks.frame)))


def steps_of(
    path: CameraPath,
    camera: int,
    frames: Int64[np.ndarray, " T"],
    middle: Float64[np.ndarray, "T 2"],
) -> Float64[np.ndarray, "T 3"]:
    """The scale and the shift from each frame to the next along a path, pixels; turns are left out.

    Args:
        path: Where the camera looked.
        camera: Its number.
        frames: The frames; the first step is that of rest.
        middle: A point of each frame that its step is exact at.
    """
    place = path.at(np.full(len(frames), camera), frames)
    steps = np.tile([1.0, 0.0, 0.0], (len(frames), 1))
    if len(frames) < 2:
        return steps
    back = inverse(place[1:])
    linear = back[:, :, :2] @ place[:-1, :, :2]
    shift = (back[:, :, :2] @ place[:-1, :, 2:])[:, :, 0] + back[:, :, 2]
    steps[1:, 0] = np.sqrt(np.linalg.det(linear))
    now = (linear @ middle[:-1, :, None])[:, :, 0] + shift
    steps[1:, 1:] = now - steps[1:, :1] * middle[:-1]
    return steps


def path_of_steps(
    steps: Float64[np.ndarray, "T 3"], camera: int, frames: Int64[np.ndarray, " T"]
) -> CameraPath:
    """The path that steps of scale and shift (pixels) make, from the first frame on."""
    scale, shift = 1.0, np.zeros(2)
    transform = np.zeros((len(frames), 2, 3))
    for t, step in enumerate(steps[: len(frames)]):
        if t:
            scale, shift = step[0] * scale, step[0] * shift + step[1:]
        transform[t] = np.column_stack([np.eye(2) / scale, -shift / scale])
    return CameraPath(np.full(len(frames), camera), frames, transform)


def frames_and_cameras(observations: Observations) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (m,) of the frames, and of the cameras, which are 0 where there is one."""
    frame = observations["frame"]
    camera = observations.camera
    return frame.cpu().numpy(), camera.cpu().numpy()


def moved_boxes(box: Float[Tensor, "m 4"], transform: Float[Tensor, "m 2 3"]) -> Tensor:
    """Boxes x1 y1 x2 y2 whose middles are moved and whose sides are scaled by similarities.

    They are not turned: people stand upright in the picture, whatever the camera does.
    """
    middle, half = (box[:, :2] + box[:, 2:]) / 2, (box[:, 2:] - box[:, :2]) / 2
    linear, shift = transform[:, :, :2], transform[:, :, 2]
    middle = (linear @ middle[:, :, None])[:, :, 0] + shift
    half = half * torch.linalg.det(linear).sqrt()[:, None]
    return torch.cat([middle - half, middle + half], 1)


def inverse(transform: Float64[np.ndarray, "n 2 3"]) -> Float64[np.ndarray, "n 2 3"]:
    """The transforms that undo these."""
    linear = np.linalg.inv(transform[:, :, :2])
    return np.concatenate([linear, -linear @ transform[:, :, 2:]], 2)


def accumulated(
    steps: Float64[np.ndarray, "F 2 3"],
    centre: Float64[np.ndarray, " 2"],
    kept: Float64[np.ndarray, " F"],
) -> Float64[np.ndarray, "F 2 3"]:
    """Transforms to coordinates in which the scene rests, from the steps between frames.

    With step k the similarity S_k from frame k - 1 to frame k, of scale s_k and angle g_k, the
    transform of frame k is A_k(p) = L_k (p - c) + a_k about the centre c of the picture:

        log |L_k| = kept_k (log |L_{k-1}| - log s_k),   angle(L_k) = kept_k (angle(L_{k-1}) - g_k),
        a_k = A_{k-1}(S_k^-1(c)),                       A_0 the identity.

    With kept = 1 this is the product of all inverse steps. A camera that goes forwards would then
    shrink its pictures to nothing, one that rolls would lay people on their side, and small errors
    would add up to either. With kept < 1 scale and angle forget: jerks of both are taken out, and
    a steady zoom of r a second, kept for T seconds, changes sizes by exp(r T) at most and is left
    as what it is in the picture, a steady motion away from the centre. Shifts are never forgotten:
    what rests at the centre of the picture rests exactly, and only distances matter, which are
    measured where they are small.

    Args:
        steps: The first is not looked at.
        centre: Of the picture, pixels.
        kept: Share of scale and angle that is remembered from the frame before.
    """
    scale = 0.5 * np.log(np.linalg.det(steps[:, :, :2]))
    angle = np.arctan2(steps[:, 1, 0], steps[:, 0, 0])
    before = inverse(steps)
    previous = before[:, :, :2] @ centre + before[:, :, 2]
    found = np.empty_like(steps)
    size, turn, place = 0.0, 0.0, centre
    linear = np.eye(2)
    for k in range(len(steps)):
        if k:
            place = linear @ (previous[k] - centre) + place
            size, turn = kept[k] * (size - scale[k]), kept[k] * (turn - angle[k])
        cos, sin = np.exp(size) * np.cos(turn), np.exp(size) * np.sin(turn)
        linear = np.array([[cos, -sin], [sin, cos]])
        found[k] = np.column_stack([linear, place - linear @ centre])
    return found


def _with_boxes(tracks: Tracks, transform: Float64[np.ndarray, "n 2 3"]) -> Tracks:
    box = moved_boxes(torch.from_numpy(tracks.box), torch.from_numpy(transform)).numpy()
    return Tracks(
        tracks.frame, tracks.identity, box, tracks.confidence, tracks.camera, tracks.observation
    )
