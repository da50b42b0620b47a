"""The parking lot: determinism, geometry against the true world, noise that does what it says."""

import numpy as np
import pytest
import torch

from mixer_torch.datasets.parking_lot import ParkingLot
from mixer_torch.demo.camera import develop, drive, loop_length, odometry_error
from mixer_torch.demo.detector import look
from mixer_torch.demo.scene import layout_for, park

EXACT = {
    "odometry_drift": 0.0,
    "box_jitter": 0.0,
    "miss_rate": 0.0,
    "range_noise": 0.0,
    "range_dropout": 0.0,
}
FEATURES = ("time", "camera", "box", "position", "confidence", "identity")


@pytest.fixture(scope="module")
def lot():
    """The lot as it ships: without pixels, which are rendered only where asked for."""
    return ParkingLot(seed=0).load()


@pytest.fixture(scope="module")
def exact():
    dataset = ParkingLot(seed=4, num_cars=20, num_frames=12, **EXACT)
    return dataset.load(), dataset.world()


@pytest.fixture(scope="module")
def cars():
    return park(layout_for(29), 29, np.random.default_rng(0))


def centres(world):
    return np.array([[*car.position, 0.7] for car in world.scene.cars])


def rendered(observations, index):
    return observations.images.frames[index].astype(float)


def test_the_same_seed_gives_the_same_lot_and_another_seed_another():
    small = {"num_cars": 4, "num_frames": 3, "width": 160, "height": 120}
    first, again = ParkingLot(seed=1, **small).load(), ParkingLot(seed=1, **small).load()
    other = ParkingLot(seed=2, **small).load()
    assert torch.equal(first.view, again.view)
    for name in FEATURES:
        torch.testing.assert_close(first[name], again[name], rtol=0, atol=0, equal_nan=True)
    np.testing.assert_array_equal(rendered(first, 2), rendered(again, 2))
    assert np.abs(rendered(first, 2) - rendered(other, 2)).mean() > 10


def test_frames_do_not_depend_on_the_order_in_which_they_are_asked_for():
    small = {"seed": 1, "num_cars": 4, "num_frames": 3, "width": 160, "height": 120}
    forwards, backwards = ParkingLot(**small).load().images, ParkingLot(**small).load().images
    one = [forwards.frames[k] for k in (0, 1, 2)]
    two = [backwards.frames[k] for k in (2, 1, 0)][::-1]
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(forwards.frames[-1], forwards.frames[2])
    with pytest.raises(IndexError, match="frame 3 of a sequence of 3"):
        forwards.frames[3]


def test_frames_are_rgb_pictures_of_an_outdoor_scene():
    frames = ParkingLot(seed=0, num_cars=10, num_frames=3).load().images.frames
    assert len(frames) == 3
    for frame in frames:
        assert frame.shape == (480, 640, 3)
        assert frame.dtype == np.uint8
        assert frame.std() > 25
        sky, asphalt = frame[:60].max(2), frame[-60:].mean((0, 1))
        assert np.quantile(sky, 0.75) > asphalt.mean() + 20
        assert np.ptp(asphalt) < 30
    assert np.abs(frames[0].astype(float) - frames[1]).mean() > 5


def test_the_lot_as_it_ships_has_the_size_of_the_papers(lot):
    per_frame = np.bincount(lot["frame"], minlength=100)
    assert 300 <= len(lot) <= 700
    assert 3.5 <= per_frame.mean() <= 8
    assert set(lot["identity"].tolist()) <= set(range(29))
    assert len(lot["identity"].unique()) >= 27
    assert torch.equal(lot.view, lot["frame"])
    assert torch.equal(lot["time"], lot["frame"].double() / 2)
    assert (lot["camera"] == 0).all()
    assert ((lot["confidence"] > 0) & (lot["confidence"] < 1)).all()


def test_some_cars_are_twins(cars):
    kinds = [(car.body.name, car.colour) for car in cars]
    assert max(kinds.count(kind) for kind in kinds) >= 4
    assert len(set(kinds)) >= 10


def test_an_identity_occurs_at_most_once_in_a_frame(lot):
    pairs = torch.stack([lot["frame"], lot["identity"]], 1)
    assert len(torch.unique(pairs, dim=0)) == len(lot)


def test_boxes_are_inside_the_image_and_not_empty(lot):
    box = lot["box"]
    assert (box >= 0).all()
    assert (box[:, 2] <= 640).all()
    assert (box[:, 3] <= 480).all()
    assert (box[:, 2:] - box[:, :2] >= 4 - 1e-3).all()
    assert lot.images.crop(0).shape[2] == 3


def test_many_cars_are_seen_again_after_a_long_gap(lot):
    frame, identity = lot["frame"], lot["identity"]
    again = 0
    for car in identity.unique():
        seen = frame[identity == car].sort().values
        again += int((seen.diff() > 30).any())
    assert again >= 8


def test_a_box_encloses_the_projection_of_its_cars_centre(exact):
    observations, world = exact
    inside = 0
    for k in range(len(observations)):
        camera = world.cameras[observations["frame"][k]]
        x, y, near = camera.project(centres(world)[[observations["identity"][k]]])[0]
        if near == 0 or not (0 <= x < 640 and 0 <= y < 480):
            continue
        sight = look(world.scene, camera)
        car = int(observations["identity"][k])
        assert sight.whole[car, 0] <= x <= sight.whole[car, 2]
        assert sight.whole[car, 1] <= y <= sight.whole[car, 3]
        if sight.visible[car] > 0.9:
            left, top, right, bottom = observations["box"][k].tolist()
            assert left <= x <= right
            assert top <= y <= bottom
            inside += 1
    assert inside >= 10


def test_silhouettes_agree_with_projected_vertices(exact):
    _, world = exact
    camera, mesh = world.cameras[0], world.scene.mesh
    sight = look(world.scene, camera)
    for car in np.flatnonzero(sight.visible > 0):
        corners = camera.project(mesh.vertices[mesh.faces[mesh.owner == car].ravel()])[:, :2]
        np.testing.assert_allclose(sight.whole[car, :2], corners.min(0), atol=0.01)
        np.testing.assert_allclose(sight.whole[car, 2:], corners.max(0), atol=0.01)
        assert (sight.seen[car, :2] >= np.maximum(sight.whole[car, :2], 0) - 2).all()
        assert (sight.seen[car, 2:] <= sight.whole[car, 2:] + 2).all()
        assert 0 < sight.visible[car] <= 1


def test_without_noise_a_position_is_on_the_car(exact):
    observations, world = exact
    off = observations["position"].numpy() - centres(world)[observations["identity"]]
    clear = np.array([
        look(world.scene, world.cameras[f]).visible[i] > 0.9
        for f, i in zip(observations["frame"], observations["identity"], strict=True)
    ])  # fmt: skip
    assert clear.sum() >= 10
    distance = np.linalg.norm(off[clear], axis=1)
    assert np.median(distance) < 2.5
    assert (distance < 3.2).mean() > 0.8


def test_depth_and_projection_are_inverse(exact):
    _, world = exact
    sight = look(world.scene, world.cameras[5])
    row, column = np.array([100, 150, 200]), np.array([40, 160, 300])
    points = sight.points(row, column, np.zeros(3))
    back = sight.camera.scaled(0.5).project(points)
    np.testing.assert_allclose(back[:, 0], column + 0.5, atol=0.01)
    np.testing.assert_allclose(back[:, 1], row + 0.5, atol=0.01)
    np.testing.assert_allclose(1 / back[:, 2], sight.depth[row, column], rtol=1e-4)
    farther = sight.points(row, column, np.full(3, 0.5))
    np.testing.assert_allclose(np.linalg.norm(farther - points, axis=1), 0.5, rtol=1e-6)


def test_drift_is_small_over_a_few_frames_and_large_over_a_lap():
    short, long = [], []
    layout = layout_for(29)
    for seed in range(20):
        generator = np.random.default_rng(seed)
        poses = drive(layout, np.arange(100) * 0.95, generator)
        revisit = round(loop_length(layout) / 0.95)
        assert np.linalg.norm(poses[revisit, :2] - poses[0, :2]) < 2.5
        place = poses[0, :2] + np.array([6.0, 3.0])
        believed = []
        for angle, x, y in odometry_error(poses, 0.2, generator):
            c, s = np.cos(angle), np.sin(angle)
            believed.append(np.array([[c, -s], [s, c]]) @ place + [x, y])
        believed = np.array(believed)
        short.append(np.linalg.norm(believed[3] - believed[0]))
        long.append(np.linalg.norm(believed[revisit] - believed[0]))
    assert np.median(short) < 0.3
    assert np.median(long) > 1.0


def test_odometry_without_drift_has_no_error():
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.3], [1.5, 2.0, 1.2]])
    error = odometry_error(poses, 0.0, np.random.default_rng(0))
    np.testing.assert_allclose(error, 0, atol=1e-12)


def test_odometry_starts_at_the_truth_and_keeps_its_steps_lengths():
    poses = np.cumsum(np.random.default_rng(0).normal(size=(30, 3)), axis=0)
    error = odometry_error(poses, 0.2, np.random.default_rng(1))
    np.testing.assert_allclose(error[0], 0, atol=1e-12)
    turn = np.stack([np.cos(error[:, 0]), np.sin(error[:, 0])], 1)
    x, y = poses[:, 0], poses[:, 1]
    believed = np.stack([turn[:, 0] * x - turn[:, 1] * y, turn[:, 1] * x + turn[:, 0] * y], 1)
    steps = np.linalg.norm(np.diff(believed + error[:, 1:3], axis=0), axis=1)
    ratio = steps / np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    assert abs(ratio[0] - 1) < 0.1


def test_neither_order_nor_any_feature_tells_the_identitys_number(lot, cars):
    identity = lot["identity"].double()
    rank = torch.zeros(len(lot), dtype=torch.float64)
    for frame in lot["frame"].unique():
        rows = (lot["frame"] == frame).nonzero()[:, 0]
        rank[rows] = torch.linspace(-1, 1, len(rows), dtype=torch.float64) if len(rows) > 1 else 0.0
    # 0.2 is more than three standard errors of a correlation over 300 independent rows.
    assert abs(np.corrcoef(rank, identity)[0, 1]) < 0.2
    number = np.arange(len(cars))
    x, y = np.array([car.position for car in cars]).T
    # Of 29 cars; 0.55 is about three standard errors.
    assert abs(np.corrcoef(number, x)[0, 1]) < 0.55
    assert abs(np.corrcoef(number, y)[0, 1]) < 0.55


def test_a_detector_that_misses_everything_sees_nothing():
    empty = ParkingLot(num_cars=4, num_frames=2, width=160, height=120, miss_rate=1.0).load()
    assert len(empty) == 0
    assert empty["box"].shape == (0, 4)
    assert empty["position"].shape == (0, 3)
    assert len(empty.images) == 0


def test_without_range_points_there_is_no_position():
    blind = ParkingLot(num_cars=16, num_frames=2, range_dropout=1.0).load()
    assert len(blind) > 0
    assert blind["position"].isnan().all()


def test_harsh_light_loses_more_in_highlights_and_shadows():
    light = np.geomspace(0.005, 5.0, 64 * 64 * 3).reshape(64, 64, 3).astype(np.float32)
    lost = []
    for harshness in (0.0, 1.0, 3.0):
        frame = develop(light, 1.0, harshness, np.random.default_rng(0))
        lost.append(((frame == 255) | (frame <= 20)).mean())
    assert lost[0] < lost[1] < lost[2]


def test_harsh_light_takes_colour_away():
    light = np.full((64, 64, 3), [0.6, 0.2, 0.2], np.float32)
    spread = []
    for harshness in (0.0, 2.0):
        frame = develop(light, 0.5, harshness, np.random.default_rng(0))
        spread.append(np.ptp(frame[24:40, 24:40].astype(float).mean((0, 1))))
    assert spread[1] < spread[0]


@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        ("seed", -1, "seed: expected an integer of 0 or more, got -1"),
        ("num_cars", 0, "num_cars: expected an integer of 1 or more, got 0"),
        ("num_frames", 0, "num_frames: expected an integer of 1 or more, got 0"),
        ("width", 10, "width: expected an integer of 64 or more, got 10"),
        ("height", 10, "height: expected an integer of 64 or more, got 10"),
        ("speed", 0.0, "speed: expected a finite number above 0, got 0.0"),
        ("frame_rate", float("inf"), "frame_rate: expected a finite number above 0, got inf"),
        ("miss_rate", 1.5, "miss_rate: expected a number from 0 to 1, got 1.5"),
        ("box_jitter", -0.1, "box_jitter: expected a number from 0 to 1, got -0.1"),
        ("range_noise", float("nan"), "range_noise: expected a number from 0 to 10, got nan"),
        ("odometry_drift", 11.0, "odometry_drift: expected a number from 0 to 10, got 11.0"),
        ("light_harshness", 6.0, "light_harshness: expected a number from 0 to 5, got 6.0"),
    ],
)
def test_bad_arguments_are_refused_at_the_door(argument, value, message):
    with pytest.raises(ValueError, match=message):
        ParkingLot(**{argument: value})
