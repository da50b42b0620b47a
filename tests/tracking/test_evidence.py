"""Evidence of pairs: overlap and margins against all pairs, and what does not change it."""

import numpy as np
import pytest

from mixer_torch.boxes import centred, centred_iou, iou
from mixer_torch.tracking.evidence import (
    COLUMN,
    CONTEXT,
    FEATURES,
    FIRST_STAGE,
    LARGEST_MARGIN,
    MODALITIES,
    NONE,
    Frame,
    compared,
    compared_pairwise,
    margins,
)
from mixer_torch.tracking.measured import Measured
from mixer_torch.tracking.states import States

REST = np.array([[1.0, 0.0, 0.0]])
MEASURED = Measured(np.array([0.5]), np.array([0.9]), 0.05, 0.03, 0.01, 0.0, 3.0, REST, 100, 1.0)


def test_overlap_of_centred_boxes_is_that_of_corners():
    rng = np.random.default_rng(0)
    low = rng.uniform(0, 3, (40, 2))
    a = np.column_stack([low, low + rng.uniform(0.5, 2, (40, 2))])
    b = a[rng.permutation(40)]
    assert centred_iou(centred(a), centred(b)) == pytest.approx(np.diag(iou(a, b)))
    size = np.tile(a[:, 2:] - a[:, :2], 2) * np.array([-0.4, -0.4, 0.4, 0.4])
    other = np.tile(b[:, 2:] - b[:, :2], 2) * np.array([-0.4, -0.4, 0.4, 0.4])
    wanted = np.diag(iou(a + size, b + other))
    assert centred_iou(centred(a), centred(b), 1.8) == pytest.approx(wanted)


@pytest.mark.parametrize("seed", range(10))
def test_margins_against_all_rivals(seed):
    rng = np.random.default_rng(seed)
    group = rng.integers(0, 5, 12)
    evidence = rng.normal(0, 4, 12)
    for k, found in enumerate(margins(evidence, group)):
        rivals = [e for j, e in enumerate(evidence) if j != k and group[j] == group[k]]
        assert found == pytest.approx(min(evidence[k] - max(rivals, default=NONE), LARGEST_MARGIN))
    assert len(margins(np.zeros(0), np.zeros(0, dtype=int))) == 0


def tracks_and_frame(seed=0, n=6, m=7, categories=1):
    rng = np.random.default_rng(seed)
    boxes = np.column_stack([rng.uniform(0, 4, (n, 2)), rng.uniform(0.7, 1.4, (n, 2))])
    kind = np.arange(n) % categories
    ids = np.arange(n)
    states = States.none().started(ids, boxes, 0.0, np.zeros(n), kind, ids)
    for t in range(1, 5):
        boxes = boxes + rng.normal(0, 0.03, boxes.shape)
        states.observed(ids, ids, boxes, float(t), rng.normal(size=n))
    found = np.column_stack([rng.uniform(0, 4, (m, 2)), rng.uniform(0.7, 1.4, (m, 2))])
    frame = Frame(
        np.arange(m), found, rng.normal(size=m), np.zeros(m), np.zeros(m), np.arange(m) % categories
    )
    return states, frame


def test_every_feature_has_one_modality():
    named = [name for key in FIRST_STAGE for name in MODALITIES[key]]
    assert (*named, *CONTEXT) == FEATURES
    assert len(set(FEATURES)) == len(FEATURES)
    pairs = compared(*tracks_and_frame(), 5.0, MEASURED)
    assert pairs.features.shape == (len(pairs.track), len(FEATURES))
    assert np.isfinite(pairs.features).all()


def test_pairs_alone_say_the_same_as_pairs_of_a_frame():
    states, frame = tracks_and_frame()
    pairs = compared(states, frame, 5.0, MEASURED)
    assert len(pairs.track) > 3
    seen = [c[pairs.detection] for c in (frame.odds, frame.overlap, frame.neighbours)]
    alone = compared_pairwise(
        states.select(pairs.track), frame.box[pairs.detection],
        np.full(len(pairs.track), 5.0), seen, MEASURED,
    )  # fmt: skip
    same = np.array([name != "crowd_track" for name in FEATURES])
    assert alone[:, same] == pytest.approx(pairs.features[:, same])


def test_features_do_not_depend_on_the_unit_of_length():
    states, frame = tracks_and_frame()
    before = compared(states, frame, 5.0, MEASURED).features
    states.history[:, :, :4] *= 100
    larger = Frame(frame.row, 100 * frame.box, *list(vars(frame).values())[2:])
    assert compared(states, larger, 5.0, MEASURED).features == pytest.approx(before)


def test_categories_are_not_compared():
    states, frame = tracks_and_frame(categories=2)
    pairs = compared(states, frame, 5.0, MEASURED)
    assert (states.category[pairs.track] == frame.category[pairs.detection]).all()
    assert len(pairs.track)


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 3), (3, 0)])
def test_nothing_to_compare(n, m):
    pairs = compared(*tracks_and_frame(n=n, m=m), 5.0, MEASURED)
    assert pairs.features.shape == (0, len(FEATURES))


def test_a_better_place_overlaps_more():
    states, frame = tracks_and_frame(n=1, m=2)
    frame.box[0] = states.history[0, -1, :4]
    frame.box[1] = states.history[0, -1, :4] + [0.5, 0, 0, 0]
    features = compared(states, frame, 5.0, MEASURED).features
    assert features[0, COLUMN["iou_0"]] == pytest.approx(1.0)
    assert features[1, COLUMN["iou_0"]] < features[0, COLUMN["iou_0"]]
