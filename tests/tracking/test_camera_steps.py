"""The camera's motion from boxes alone, against simulated cameras whose motion is known."""

import numpy as np
import pytest

from mixer_torch.datasets.simulated import HEIGHT, WIDTH, Scene, Simulated
from mixer_torch.tracking.camera_steps import AT_REST, camera_step, moved, mutual_best
from mixer_torch.tracking.measured import Sequence, measure

MIDDLE = np.array([WIDTH, HEIGHT]) / 2


def boxes(n=12, seed=0):
    rng = np.random.default_rng(seed)
    place = rng.uniform(0, 20, (n, 2))
    side = rng.uniform(0.6, 1.5, (n, 1)) * np.array([[0.6, 1.6]])
    return np.concatenate([place, side], 1)


@pytest.mark.parametrize(
    "step", [(1.0, 0.7, -0.2), (1.02, -0.4, 0.1), (0.98, 0.0, 0.6), (1.0, 0.9, 0.4)]
)
def test_a_similarity_of_all_boxes_is_found(step):
    a = boxes()
    found, gain, links = camera_step(
        a, moved(a, np.array(step)), np.ones(12), np.ones(12), np.zeros(2)
    )
    # growth is shrunk by a tenth of itself: what remains is that of a tenth, over the picture
    slack = 0.1 * abs(step[0] - 1) * 20 + 1e-6
    assert np.allclose(moved(a, found)[:, :2], moved(a, np.array(step))[:, :2], atol=slack)
    assert gain > 0
    assert links == 12


def test_a_few_boxes_that_move_by_themselves_change_nothing():
    a = boxes()
    b = moved(a, np.array([1.0, 0.5, 0.0]))
    b[:3, :2] += [[0.3, 0.1], [-0.3, 0.0], [0.2, 0.2]]
    found, *_ = camera_step(a, b, np.ones(12), np.ones(12), np.zeros(2))
    assert found[1:] == pytest.approx([0.5, 0.0], abs=0.02)


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 5), (2, 2), (5, 0)])
def test_with_next_to_no_boxes_the_camera_rests(n, m):
    a, b = boxes(n), boxes(m)
    step, gain, links = camera_step(a, b, np.ones(n), np.ones(m), np.zeros(2))
    assert (step == AT_REST).all()
    assert (gain, links) == (0, 0)


def test_mutual_best_partners_against_all_pairs():
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = boxes(6, int(rng.integers(1e6))), boxes(7, int(rng.integers(1e6)))
        found = mutual_best(a, b, np.array([0.1, 0.2]), 5.0)
        size = (np.sqrt(a[:, 2] * a[:, 3])[:, None] + np.sqrt(b[:, 2] * b[:, 3])) / 2
        cost = np.array(
            [
                [
                    (((q[:2] - p[:2] - [0.1, 0.2]) / size[i, j]) ** 2).sum()
                    + 0.5 * (np.log(q[2:] / p[2:]) ** 2).sum()
                    for j, q in enumerate(b)
                ]
                for i, p in enumerate(a)
            ]
        )
        for i, j in enumerate(found):
            best = int(cost[i].argmin())
            wanted = best if cost[:, best].argmin() == i and cost[i, best] <= 25 else -1
            assert j == wanted


def measured(scene, seed):
    simulated = Simulated(scene, seed)
    seen = simulated.load()
    sequence = Sequence.of(
        seen["frame"].numpy(), seen["box"].double().numpy(), seen["confidence"].numpy()
    )
    return simulated, sequence, measure(sequence)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "motion", [{"pan": 8.0}, {"pan": 3.0, "zoom": 0.004}], ids=["pans", "pans and zooms"]
)
def test_a_moving_camera_is_followed(motion, seed):
    """What is taken out is the camera's motion to a twentieth of a box's size a frame (median)."""
    scene = Scene(frames=150, things=20, speed=0.4, clutter=0.2, miss=0.02, **motion)
    simulated, sequence, found = measured(scene, seed)
    path = simulated.camera_path
    errors = []
    for t in range(1, len(sequence.frames)):
        frame = sequence.frames[t] - 1
        scale = path[frame, 0] / path[frame - 1, 0]
        # of a point in the middle of the picture
        shift = path[frame, 1:] - scale * path[frame - 1, 1:]
        true = shift
        s, *move = found.camera[t]
        errors.append(np.hypot(*((s - 1) * MIDDLE + np.array(move) * found.unit - true)))
    assert np.median(errors) / found.unit < 0.05
    assert found.camera_moves > 0.4


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("speed", [0.3, 1.5])
def test_a_resting_camera_is_left_at_rest(seed, speed):
    *_, found = measured(Scene(frames=150, things=15, speed=speed), seed)
    assert found.camera_moves < 0.1
