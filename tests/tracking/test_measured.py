"""What is measured without labels, against simulations in which it is known."""

import numpy as np
import pytest

from mixer_torch.datasets.simulated import Scene, Simulated
from mixer_torch.tracking.measured import Sequence, continuations, measure
from mixer_torch.tracking.running import REMEMBERED, Running


def sequence_of(scene, seed=0, score=None):
    seen = Simulated(scene, seed).load()
    values = seen["confidence"].double().numpy()
    values = values if score is None else score(values)
    return seen, Sequence.of(seen["frame"].numpy(), seen["box"].double().numpy(), values)


@pytest.mark.parametrize("jitter", [0.02, 0.05])
def test_the_jitter_of_boxes_is_measured(jitter):
    """Within a factor of two: errors of the simulated detector are alike from frame to frame."""
    _, sequence = sequence_of(Scene(frames=200, things=12, jitter=jitter, clutter=0))
    # independent from frame to frame, as the estimate takes it
    rng = np.random.default_rng(0)
    clean = Simulated(Scene(frames=200, things=12, jitter=0.0, clutter=0), 0).load()
    box = clean["box"].double().numpy()
    side = box[:, 2:] - box[:, :2]
    box = (
        box
        + jitter * rng.normal(size=(len(box), 2))[:, [0, 1, 0, 1]] * np.sqrt(side.prod(1))[:, None]
    )
    frame = clean["frame"].numpy()
    found = measure(Sequence.of(frame, box, clean["confidence"].numpy()))
    assert found.jitter == pytest.approx(jitter, rel=0.3)
    assert 0 < measure(sequence).jitter < 1.5 * jitter


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_the_motion_of_things_is_measured(speed):
    """Against the median of true displacements, within a quarter."""
    scene = Scene(frames=200, things=10, speed=speed, jitter=0.0, clutter=0, miss=0.02)
    seen, sequence = sequence_of(scene)
    found = measure(sequence)
    identity, frame = seen["identity"].numpy(), seen["frame"].numpy()
    order = np.lexsort((frame, identity))
    follows = (np.diff(identity[order]) == 0) & (np.diff(frame[order]) == 1)
    box = sequence.box[order]
    size = np.sqrt(box[:-1, 2] * box[:-1, 3])
    step = np.hypot(*(box[1:, :2] - box[:-1, :2]).T) / size
    assert found.motion == pytest.approx(np.median(step[follows]), rel=0.25)


def test_scores_mean_more_where_they_are_higher_and_clutter_goes_on_less():
    scene = Scene(frames=300, things=10, clutter=6.0, ghosts=1.0)
    seen, sequence = sequence_of(scene)
    found = measure(sequence)
    assert (np.diff(found.meaning) >= 0).all()
    true = seen["identity"].numpy() >= 0
    meaning = found.means(sequence.score)
    assert meaning[true].mean() > meaning[~true].mean() + 0.2
    _, clean = sequence_of(Scene(frames=300, things=10, clutter=0.0))
    assert found.clutter > 3 > 1 > measure(clean).clutter


SCALES = {
    "shifted": lambda c: 0.9 * c - 0.05,
    "percents": lambda c: 100 * c,
    "logits": lambda c: np.log(c / (1 - c)),
}


@pytest.mark.parametrize("scale", SCALES.values(), ids=SCALES)
def test_only_the_order_of_scores_counts(scale):
    scene = Scene(frames=150, things=10, clutter=2.0)
    _, plain = sequence_of(scene)
    _, other = sequence_of(scene, score=scale)
    a, b = measure(plain), measure(other)
    assert a.means(plain.score) == pytest.approx(b.means(other.score), abs=0.02)
    assert a.camera == pytest.approx(b.camera, abs=1e-6)


def test_scores_that_are_all_alike_mean_what_all_detections_do():
    _, sequence = sequence_of(Scene(frames=100, things=10, clutter=0), score=np.ones_like)
    found = measure(sequence)
    assert len(found.levels) == 1
    assert found.means(np.ones(3)) == pytest.approx(found.meaning.repeat(3))
    assert found.rank(np.ones(3)).tolist() == [0.5] * 3


@pytest.mark.parametrize("factor", [10, 1e-3])
def test_boxes_of_another_scale_measure_the_same(factor):
    seen = Simulated(Scene(frames=100, pan=5.0), 0).load()
    frame, box = seen["frame"].numpy(), seen["box"].double().numpy()
    score = seen["confidence"].numpy()
    a, b = (measure(Sequence.of(frame, f * box, score)) for f in (1, factor))
    assert b.unit == pytest.approx(factor * a.unit)
    assert b.camera == pytest.approx(a.camera, abs=1e-6)
    assert (b.motion, b.change, b.jitter) == pytest.approx((a.motion, a.change, a.jitter))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_next_to_nothing_is_measured_as_what_is_common(count):
    box = np.array([[0.0, 0, 10, 20], [1.0, 0, 11, 20]])[:count]
    found = measure(Sequence.of(np.arange(1, count + 1), box, np.ones(count)))
    assert 0 < found.motion < 1
    assert found.links <= 1
    assert "measured" in str(found)


def test_what_is_found_can_be_read():
    _, sequence = sequence_of(Scene(frames=100, pan=6.0))
    text = str(measure(sequence))
    for word in ("camera", "moves in", "jitter", "scores", "goes on", "clutter", "links"):
        assert word in text


def test_measuring_while_it_runs_agrees_with_measuring_the_whole():
    """On as many frames as are remembered; the camera rests, so the path is the same, too."""
    _, sequence = sequence_of(Scene(frames=250, things=10, clutter=1.0))
    assert len(sequence.frames) <= REMEMBERED
    running = Running(sequence.unit)
    for t in range(len(sequence.frames)):
        rows = sequence.rows(t)
        running.add(sequence.box[rows], sequence.score[rows], sequence.category[rows])
    whole, so_far = measure(sequence), running.measured
    assert so_far.motion == pytest.approx(whole.motion, rel=0.1)
    assert so_far.change == pytest.approx(whole.change, rel=0.1)
    assert so_far.means(sequence.score) == pytest.approx(whole.means(sequence.score), abs=0.05)


def test_continuations_are_mutual():
    _, sequence = sequence_of(Scene(frames=60))
    camera = np.tile([1.0, 0, 0], (60, 1))
    forward, backward = continuations(sequence, camera)
    row = np.flatnonzero(forward >= 0)
    assert (backward[forward[row]] == row).all()
    assert (sequence.frame[forward[row]] == sequence.frame[row] + 1).all()


def test_a_line_says_where_there_was_nothing_to_measure():
    one = Sequence.of(np.array([1]), np.array([[0.0, 0, 5, 9]]))
    assert measure(one).summary.startswith("too few boxes")
    walk = np.array([[k, 0.0, k + 5, 9] for k in range(40)])
    assert measure(Sequence.of(np.arange(40), walk)).summary.startswith("camera")
