"""Motion of the camera: planted in pictures of a painted scene, and found again."""

import cv2
import numpy as np
import pytest
import torch

from mixer_torch.observations import Images, Observations
from mixer_torch.tracking import CameraMotion

WIDTH, HEIGHT = 320, 240
FOREVER = 1e9


def scene(seed=0, size=(700, 900), grain=4.0):
    """A painted wall."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.normal(size=(*size, 3)), (0, 0), grain)
    return (128 + 40 * noise / noise.std()).clip(0, 255).astype(np.uint8)


def view(scale=1.0, angle=0.0, place=(450.0, 350.0)):
    """Where the pixels of a frame are on the wall: its middle at a place."""
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([linear, place - linear @ np.array([WIDTH / 2, HEIGHT / 2])])


def filmed(wall, views):
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return [cv2.warpAffine(wall, one, (WIDTH, HEIGHT), flags=flags) for one in views]


def observed(frames, boxes=None, camera=0, rate=25.0):
    """One observation a frame, or those of the boxes (F, n, 4) that were detected."""
    boxes = np.tile([0.0, 0, 2, 2], (len(frames), 1, 1)) if boxes is None else np.asarray(boxes)
    count = boxes.shape[1]
    index = np.repeat(np.arange(len(frames)), count)
    frame = torch.from_numpy(index + 1)
    features = {
        "frame": frame,
        "time": (frame - 1).double() / rate,
        "camera": torch.full_like(frame, camera),
        "box": torch.from_numpy(boxes.reshape(-1, 4)).float(),
    }
    return Observations(frame, features, Images(frames, index, boxes.reshape(-1, 4)))


def planted(views):
    """From the pixels of each frame to those of the first."""
    square = [np.vstack([one, [0, 0, 1]]) for one in views]
    return np.stack([(np.linalg.inv(square[0]) @ one)[:2] for one in square])


def miss(found, expected):
    """Greatest distance between the same corner of a picture in both, pixels."""
    corners = np.array([[0, 0, 1], [WIDTH, 0, 1], [0, HEIGHT, 1], [WIDTH, HEIGHT, 1.0]])
    return np.linalg.norm(corners @ (found - expected).transpose(0, 2, 1), axis=2).max()


TIME = np.arange(14)
MOTIONS = {
    "pan": [view(place=(450 + 60 * np.sin(t / 2), 350 + 4 * t)) for t in TIME],
    "zoom": [view(scale=np.exp(0.02 * t)) for t in TIME],
    "roll": [view(angle=0.15 * np.sin(t / 2)) for t in TIME],
    "all": [view(np.exp(0.01 * t), 0.03 * t, (450 - 8 * t, 350 + 5 * t)) for t in TIME],
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_planted_motion_is_found(motion):
    views = MOTIONS[motion]
    path = CameraMotion(memory=FOREVER).path(observed(filmed(scene(), views)))
    expected = planted(views)
    assert miss(np.tile(np.eye(2, 3), (len(views), 1, 1)), expected) > 15
    assert miss(path.transform, expected) < 1.0


def test_large_pictures_are_scaled_down_and_the_path_is_in_their_own_pixels():
    views = MOTIONS["all"]
    path = CameraMotion(width=161, memory=FOREVER).path(observed(filmed(scene(grain=6), views)))
    assert miss(path.transform, planted(views)) < 2.5


def test_jerks_of_a_quarter_of_the_picture():
    views = [view(place=(450 + shift, 350)) for shift in (0, 40, -20, 60, -30)]
    path = CameraMotion().path(observed(filmed(scene(), views)))
    assert miss(path.transform, planted(views)) < 1.0


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_a_camera_at_rest_rests_exactly(noise):
    rng = np.random.default_rng(0)
    picture = filmed(scene(), [view()])[0]
    frames = [
        (picture + noise * rng.normal(size=picture.shape)).clip(0, 255).astype(np.uint8)
        for _ in range(8)
    ]
    path = CameraMotion().path(observed(frames))
    assert np.array_equal(path.transform, np.tile(np.eye(2, 3), (8, 1, 1)))


def passers(frames):
    """Two large, painted things that go to the left, in front of more of the picture than not."""
    cloth = scene(seed=1, size=(HEIGHT, 700), grain=3.0)
    boxes = np.array([[[15, 20, 125, 220], [195, 20, 305, 220]]] * len(frames))
    filled = []
    for k, frame in enumerate(frames):
        picture = frame.copy()
        for x1, y1, x2, y2 in boxes[k]:
            picture[y1:y2, x1:x2] = cloth[y1:y2, x1 + 9 * k : x2 + 9 * k]
        filled.append(picture)
    return filled, boxes


def test_what_moves_inside_of_boxes_is_not_looked_at():
    slow = [view(place=(450 + 6 * t, 350 + 2 * t)) for t in TIME]
    frames, boxes = passers(filmed(scene(), slow))
    ours = CameraMotion(memory=FOREVER)
    expected = planted(slow)
    assert miss(ours.path(observed(frames, boxes)).transform, expected) < 1.5
    assert miss(ours.path(observed(frames)).transform, expected) > 15


def test_people_who_were_not_detected_are_outvoted():
    frames = filmed(scene(), MOTIONS["roll"])
    cloth = scene(seed=1)
    for k, frame in enumerate(frames):
        frame[40:160, 30 + 7 * k : 80 + 7 * k] = cloth[:120, :50]
    path = CameraMotion(memory=FOREVER).path(observed(frames))
    assert miss(path.transform, planted(MOTIONS["roll"])) < 1.5


def test_nothing_to_follow_is_rest():
    blank = [np.full((HEIGHT, WIDTH, 3), grey, np.uint8) for grey in (90, 91, 90)]
    eye = np.tile(np.eye(2, 3), (3, 1, 1))
    assert np.array_equal(CameraMotion().path(observed(blank)).transform, eye)
    cuts = [filmed(scene(seed), [view()])[0] for seed in range(3)]
    assert np.array_equal(CameraMotion().path(observed(cuts)).transform, eye)
    everything = np.tile([0.0, 0, WIDTH, HEIGHT], (len(TIME), 1, 1))
    hidden = observed(filmed(scene(), MOTIONS["pan"]), everything)
    assert (CameraMotion().path(hidden).transform == np.eye(2, 3)).all()


def test_frames_without_observations_are_stepped_over():
    seen = observed(filmed(scene(), MOTIONS["all"]))
    some = torch.tensor([0, 1, 3, 4, 6, 7, 8, 10, 12])
    path = CameraMotion(memory=FOREVER).path(seen.select(some))
    assert path.frame.tolist() == (some + 1).tolist()
    assert miss(path.transform, planted(MOTIONS["all"])[some]) < 1.0


def test_cameras_have_paths_of_their_own():
    first = observed(filmed(scene(), MOTIONS["pan"]))
    frames = [*first.images.frames, *filmed(scene(3), MOTIONS["roll"])]
    n = len(TIME)
    both = Observations(
        torch.arange(2 * n),
        {
            "frame": torch.arange(n).repeat_interleave(2),
            "time": torch.arange(n).repeat_interleave(2).double() / 25,
            "camera": torch.tensor([7, 2]).repeat(n),
            "box": torch.zeros(2 * n, 4),
        },
        Images(frames, np.stack([np.arange(n), n + np.arange(n)], 1).ravel()),
    )
    told = []
    path = CameraMotion(memory=FOREVER).path(both, lambda *what: told.append(what))
    assert path.camera.tolist() == [2] * n + [7] * n
    assert miss(path.transform[:n], planted(MOTIONS["roll"])) < 1.0
    assert miss(path.transform[n:], planted(MOTIONS["pan"])) < 1.0
    assert told == [("camera motion", k + 1, 2 * n) for k in range(2 * n)]


def test_the_order_of_observations_is_of_no_concern():
    frames, boxes = passers(filmed(scene(), MOTIONS["all"]))
    seen = observed(frames, boxes)
    order = torch.randperm(len(seen), generator=torch.Generator().manual_seed(0))
    ours = CameraMotion()
    assert np.array_equal(ours.path(seen.select(order)).transform, ours.path(seen).transform)


def test_the_same_pixels_give_the_same_path():
    rng = np.random.default_rng(0)
    frames = filmed(scene(), MOTIONS["all"])
    for frame in frames:  # for RANSAC to have something to choose from
        frame[:, :90] = rng.integers(0, 255, (HEIGHT, 90, 3))
    first = CameraMotion().path(observed(frames)).transform
    cv2.setRNGSeed(12345)
    np.random.seed(1)
    torch.rand(3)
    assert np.array_equal(CameraMotion().path(observed(frames)).transform, first)


def test_without_pixels():
    seen = observed(filmed(scene(), [view()]))
    with pytest.raises(ValueError, match=r"camera_motion: expected observations with images"):
        CameraMotion().path(Observations(seen.view, seen.features))
    with pytest.raises(KeyError, match="time"):
        CameraMotion().path(
            Observations(seen.view, {"frame": seen.view, "box": seen["box"]}, seen.images)
        )


def test_without_observations():
    seen = observed(filmed(scene(), [view()]))
    none = seen.select(torch.zeros(1, dtype=torch.bool))
    for nothing in (none, Observations(none.view, none.features)):
        path = CameraMotion().path(nothing)
        assert len(path) == 0
        assert len(path.stabilised(nothing)) == 0


def test_frames_of_one_camera_are_of_one_size():
    frames = filmed(scene(), [view(), view()])
    with pytest.raises(ValueError, match=r"images: expected frames of one size .* \[320 120\]"):
        CameraMotion().path(observed([frames[0], frames[1][:120]]))


@pytest.mark.parametrize(
    "settings",
    [
        {"width": 8},
        {"min_points": 2},
        {"min_points": 401},
        {"tolerance": 0.0},
        {"still": -1.0},
        {"min_share": 1.5},
        {"memory": float("inf")},
    ],
)
def test_bad_settings(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        CameraMotion(**settings)
