"""Several cameras: two that look at one made-up place, and the two of the real one."""

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import mixer_torch as mx
from mixer_torch.cli import build_parsers
from mixer_torch.datasets.calibration import Homography, Pinhole
from mixer_torch.datasets.multicamera import Camera, MultiCamera, standing_points
from mixer_torch.metrics.clustering import pairwise
from mixer_torch.scorers import Proximity

K = np.array([[1000.0, 0, 960], [0, 1000, 540], [0, 0, 1]])
LEVEL = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks north
CENTRES = {"south": (np.array([0.0, -12, 3]), 0.0), "west": (np.array([-12.0, 0, 3]), -np.pi / 2)}


def pinhole(name):
    centre, turn = CENTRES[name]
    rotation = LEVEL @ Rotation.from_euler("z", -turn).as_matrix()
    return Pinhole(K, rotation, -rotation @ centre)


def person(camera, ground):
    """Box of a person of 1.8 m, 0.5 m wide in the picture, whose feet are at a place."""
    pixels = []
    for height in (0.0, 1.8):
        u, v, w = camera.intrinsics @ (camera.rotation @ [*ground, height] + camera.translation)
        pixels.append((u / w, v / w))
    half = 250 / w
    (foot, low), (_, high) = pixels
    return foot - half, high, foot + half, low


def place(identity, frame):
    """Two people who walk towards each other and pass at a metre, one who stands."""
    time = frame / 10
    return {1: (time - 2, 0.5), 2: (2 - time, -0.5), 3: (0.0, 4.0)}[identity]


@pytest.fixture
def folder(tmp_path):
    """Detections of 40 frames at 10 a second: of the west MOTChallenge, of the south VATIC."""
    for name in CENTRES:
        camera = pinhole(name)
        matrices = {"K": K, "R": camera.rotation, "centre": camera.centre}
        text = json.dumps({key: value.tolist() for key, value in matrices.items()})
        (tmp_path / f"{name}.json").write_text(text)
        mot, vatic = [], []
        for frame in range(40):
            for identity in (1, 2, 3):
                x1, y1, x2, y2 = person(camera, place(identity, frame))
                size = f"{x1},{y1},{x2 - x1},{y2 - y1}"
                mot.append(f"{frame + 1},{identity},{size},1,-1,-1,-1\n")
                vatic.append(f'{identity} {x1} {y1} {x2} {y2} {frame} 0 0 0 "PERSON"\n')
        (tmp_path / f"{name}.txt").write_text("".join(mot if name == "west" else vatic))
    return tmp_path


def cameras(folder, truth=True, **changes):
    """West counts frames from 1, south from 0."""
    return [
        Camera(
            **{"boxes": folder / f"{name}.txt", "calibration": folder / f"{name}.json"}
            | ({"truth": folder / f"{name}.txt"} if truth else {})
            | {"delay": int(name == "west")}
            | changes
        )
        for name in ("south", "west")
    ]


@pytest.mark.parametrize("source", ["det", "gt"])
def test_features(folder, source):
    seen = MultiCamera(cameras(folder), 10.0, start=5, stop=30, step=5, source=source).load()
    frame, camera, identity = (seen[key].numpy() for key in ("frame", "camera", "identity"))
    assert np.unique(frame).tolist() == [5, 10, 15, 20, 25, 30]
    assert len(seen) == 6 * 2 * 3
    assert (np.diff(frame * 2 + camera) >= 0).all()
    np.testing.assert_array_equal(seen.view, frame * 2 + camera)
    np.testing.assert_allclose(seen["time"], frame / 10)
    expected = [(*place(i, k), 0) for i, k in zip(identity, frame, strict=True)]
    np.testing.assert_allclose(seen["position"], expected, atol=1e-4)
    assert seen["box"].dtype == torch.float32
    assert set(seen.features) == {
        "frame", "time", "camera", "box", "confidence", "identity", "position"
    }  # fmt: skip


def test_people_who_pass_are_told_apart(folder):
    # At 1 s and at 3 s, one is where the other was, to a metre.
    seen = MultiCamera(cameras(folder), 10.0, start=10, step=20, window=0.5).load()
    speed = {1: [1, 0, 0], 2: [-1, 0, 0], 3: [0, 0, 0]}
    expected = [speed[i] for i in seen["identity"].tolist()]
    np.testing.assert_allclose(seen["velocity"], expected, atol=1e-3)
    association = mx.associate(seen, [Proximity(scale=1.0, memory=5, speed=0.1, swerve=0.3)])
    assert pairwise(association.labels, seen["identity"], seen.view)["f1"] == 1
    still = mx.associate(seen, [Proximity(scale=1.0, memory=5, speed=0.1)])
    assert pairwise(still.labels, seen["identity"], seen.view)["f1"] < 1


def test_depth_moves_away_from_the_camera():
    ground = np.array([[0.0, 0.0], [1.0, 3.0]])
    for name, (centre, _) in CENTRES.items():
        camera = pinhole(name)
        box = np.array([person(camera, at) for at in ground])
        away = ground - centre[:2]
        expected = ground + 0.2 * away / np.linalg.norm(away, axis=1, keepdims=True)
        np.testing.assert_allclose(standing_points(camera, box, 0.2), expected, atol=1e-3)
    # Row 100 is the horizon, so a box that ends above it stands nowhere.
    horizon = Homography(np.array([[1.0, 0, 0], [0, 0, 500], [0, 1, -100]]))
    box = np.array([[0.0, 0, 10, 50], [0, 0, 10, 200]])
    np.testing.assert_allclose(standing_points(horizon, box, 0.0), [[np.nan] * 2, [0.05, 5]])
    assert np.isnan(standing_points(horizon, box, 0.1)).all(1).tolist() == [True, False]


def test_a_delay_before_the_first_frame_has_views_too(folder):
    seen = MultiCamera(cameras(folder, delay=10), 10.0).load()
    assert int(seen["frame"].min()) == -10
    assert int(seen.view.min()) == 0
    pairs = torch.stack([seen["frame"], seen["camera"]], 1)
    assert len(torch.unique(pairs, dim=0)) == len(torch.unique(seen.view)) == 80


def test_clutter_and_confidence(folder):
    (folder / "south.txt.gz").write_bytes(
        gzip.compress(b"1,-1,0,0,50,100,0.9,-1,-1,-1\n1,-1,5,0,50,100,0.2,-1,-1,-1\n")
    )
    chosen = cameras(folder, boxes=folder / "south.txt.gz", delay=0)
    seen = MultiCamera(chosen, 10.0, min_confidence=0.5).load()
    assert seen["identity"].tolist() == [-1, -1]
    assert seen["confidence"].tolist() == pytest.approx([0.9, 0.9])
    assert seen["position"].isnan().all()  # above the horizon


def test_without_truth_and_calibration(folder):
    seen = MultiCamera(cameras(folder, truth=False, calibration=None), 10.0, stop=3).load()
    assert set(seen.features) == {"frame", "time", "camera", "box", "confidence"}
    for window in (0.0, 0.5):
        nobody = MultiCamera(cameras(folder), 10.0, start=500, window=window).load()
        assert len(nobody) == 0
        assert nobody["position"].shape == (0, 3)


def test_pixels(folder):
    """Every frame is of one colour, which says which it is."""
    import cv2

    south, west = cameras(folder)
    for frame in range(40):
        cv2.imwrite(str(folder / f"{frame:03d}.png"), np.full((1080, 1920, 3), frame, np.uint8))
    size, codec = (192, 108), cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(folder / "west.avi"), codec, 10, size)
    for frame in range(40):
        writer.write(np.full((*size[::-1], 3), 100 + 3 * frame, np.uint8))
    writer.release()
    pictures = replace(south, images=str(folder / "{frame:03d}.png"))
    video = replace(west, video=folder / "west.avi", first_frame=1)
    seen = MultiCamera([pictures, video], 10.0, start=3, step=9).load()
    for i, (frame, camera) in enumerate(zip(seen["frame"], seen["camera"], strict=True)):
        expected = 100 + 3 * int(frame) if camera else int(frame)
        assert abs(int(seen.images.frame(i).mean()) - expected) <= (2 if camera else 0)
    with pytest.raises(ValueError, match="images, video: expected a file for every camera or"):
        MultiCamera([pictures, west], 10.0)
    with pytest.raises(ValueError, match="images, video: expected one of them"):
        replace(video, images="{frame}.png")
    late = replace(video, first_frame=2)
    with pytest.raises(ValueError, match=r"frame 1: .*west\.avi has frames 2 to 41"):
        MultiCamera([pictures, late], 10.0).load()
    for pattern, error, message in (
        ("{number}.png", ValueError, r"images: .* got '\{number\}\.png'"),
        ("{frame}.png", FileNotFoundError, r"0\.png"),
    ):
        with pytest.raises(error, match=message):
            MultiCamera([replace(south, images=pattern)], 10.0).load()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frame_rate": 0.0}, "frame_rate: expected a positive number, got 0"),
        ({"step": 0}, "step: expected 1 or more"),
        ({"min_overlap": 0.0}, "min_overlap"),
        ({"depth": -1.0}, "depth: expected a finite number >= 0"),
        ({"window": float("inf")}, "window: expected a finite number >= 0"),
        ({"cameras": []}, "cameras: expected at least one"),
    ],
)
def test_refuses(folder, changes, message):
    arguments = {"cameras": cameras(folder), "frame_rate": 10.0} | changes
    with pytest.raises(ValueError, match=message):
        MultiCamera(**arguments)


def test_refuses_files_for_some_cameras_only(folder):
    south, west = cameras(folder)
    bare = cameras(folder, truth=False, calibration=None)
    with pytest.raises(ValueError, match=r"truth: .* every camera or for none, .* cameras \[1\]"):
        MultiCamera([south, bare[1]], 10.0)
    with pytest.raises(ValueError, match=r"truth: .* every camera, got none for cameras \[0, 1\]"):
        MultiCamera(bare, 10.0, source="gt")
    with pytest.raises(ValueError, match="calibration: expected a file for every camera, got"):
        MultiCamera(bare, 10.0, window=0.5)
    gone = Camera(folder / "gone.txt", folder / "west.json", west.truth)
    with pytest.raises(FileNotFoundError, match=r"gone\.txt"):
        MultiCamera([gone], 10.0).load()


@pytest.mark.real_data
def test_two_cameras_on_a_campus(real_data):
    """Cross-camera F1 on what both see, at 1 frame a second over 182 s, by configs/campus.yaml."""
    parser = build_parsers()[1]["associate"]
    config = Path(__file__).parents[2] / "configs" / "campus.yaml"
    chosen = parser.instantiate(parser.parse_args([f"--config={config}", "--out=."]))
    seen = chosen.dataset.load()
    assert float(seen["time"].max() - seen["time"].min()) > 178
    labels = mx.associate(seen, chosen.scorers, chosen.solver, chosen.pairs).labels
    columns = (seen[key].tolist() for key in ("camera", "frame", "identity"))
    rows = list(zip(*columns, strict=True))
    known = set(rows)
    both = torch.tensor([i >= 0 and (1 - c, f, i) in known for c, f, i in rows])
    identity, camera, frame, labels = (
        x[both] for x in (seen["identity"], seen["camera"], seen["frame"], labels)
    )
    apart = camera[:, None] < camera
    for counted, floor in ((apart & (frame[:, None] == frame), 0.95), (apart, 0.8)):
        same, declared = ((x[:, None] == x) & counted for x in (identity, labels))
        f1 = 2 * (same & declared).sum() / (same.sum() + declared.sum())
        assert float(f1) > floor
    places = []
    for c in (0, 1):
        mine = camera == c
        order = np.lexsort((identity[mine], frame[mine]))
        places.append(seen["position"][both][mine][torch.from_numpy(order)])
    first, second = places
    assert float((first - second).norm(dim=1).median()) < 0.2
