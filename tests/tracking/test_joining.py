"""Tracks joined over gaps: candidates against all pairs, and answers that are known."""

import numpy as np
import pytest

from mixer_torch.tracking.joining import (
    JOIN,
    Joining,
    _together,
    at_rest,
    ends,
    joined,
)
from mixer_torch.tracking.measured import Sequence, measure
from mixer_torch.tracking.weights import Network, Weights


def walkers(gap=10, count=4, frames=60):
    """Things that walk in parallel, each unseen for some frames in the middle; labels by piece."""
    rng = np.random.default_rng(0)
    rows = []
    for who in range(count):
        for t in range(frames):
            piece = 0 if t < 25 else 1
            if 25 <= t < 25 + gap:
                continue
            x, y = 50 + 4 * t, 100 + 150 * who
            rows.append((t + 1, who, 2 * who + piece, x, y, x + 40, y + 100))
    table = np.array(rows, dtype=float)
    table = table[np.argsort(table[:, 0], kind="stable")]
    box = table[:, 3:] + rng.normal(0, 0.3, (len(table), 4))
    sequence = Sequence.of(table[:, 0].astype(int), box, np.full(len(table), 0.9))
    _, label = np.unique(table[:, 2], return_inverse=True)
    return sequence, label, table[:, 1].astype(int)


def described(sequence):
    n = len(sequence.box)
    return np.full(n, 3.0), np.zeros(n), np.zeros(n)


def test_the_two_pieces_of_each_walker_are_joined_and_no_others():
    sequence, label, who = walkers()
    found = joined(
        label, sequence, described(sequence), measure(sequence), Weights.shipped(),
        Joining(longest_gap=2.0, join_odds=2.0), 25.0,
    )  # fmt: skip
    for piece in np.unique(found):
        assert len(np.unique(who[found == piece])) == 1
    assert len(np.unique(found)) < len(np.unique(label))


def test_without_a_gap_allowed_nothing_is_joined():
    sequence, label, _ = walkers()
    arguments = label, sequence, described(sequence), measure(sequence), Weights.shipped()
    assert joined(*arguments, Joining(), 25.0) is label
    short = joined(*arguments, Joining(longest_gap=0.2, join_odds=50.0), 25.0)
    assert (short == label).all()


def test_candidates_are_all_pairs_within_reach():
    sequence, label, _ = walkers(gap=6)
    measured = measure(sequence)
    resting = at_rest(sequence, measured.camera)
    pairs = ends(label, sequence, resting, described(sequence), measured, Weights.shipped(), 30)
    frame = sequence.frame
    for a, b in zip(pairs.before, pairs.after, strict=True):
        assert 0 < frame[label == b].min() - frame[label == a].max() <= 30
    own = {(2 * k, 2 * k + 1) for k in range(4)}
    assert own <= set(zip(pairs.before.tolist(), pairs.after.tolist(), strict=True))
    gaps = np.exp(pairs.features[:, JOIN.index("gap")])
    assert gaps == pytest.approx(np.full(len(gaps), 7.0))
    bridge = pairs.features[:, JOIN.index("bridge")]
    right = np.array([(a, b) in own for a, b in zip(pairs.before, pairs.after, strict=True)])
    assert bridge[right].max() < (bridge[~right].min() if (~right).any() else np.inf)


def test_tracks_that_are_there_at_the_same_time_against_all_pairs():
    rng = np.random.default_rng(0)
    start = rng.integers(0, 40, 12)
    spans = [(s, s + int(d)) for s, d in zip(start, rng.integers(0, 20, 12), strict=True)]
    rows = sorted((t + 1, k) for k, (a, b) in enumerate(spans) for t in (a, b))
    frame = np.array([t for t, _ in rows])
    label = np.array([k for _, k in rows])
    box = np.tile([0.0, 0, 10, 20], (len(rows), 1))
    found = set(map(tuple, _together(label, Sequence.of(frame, box)).T.tolist()))
    wanted = {
        (i, j)
        for i in range(12)
        for j in range(i + 1, 12)
        if spans[i][0] <= spans[j][1] and spans[j][0] <= spans[i][1]
    }
    assert found == wanted


def test_what_overlaps_in_time_is_never_joined_however_strong_the_evidence():
    """Three pieces, two of which are there at once: a chain of joins would put all in one."""
    sequence, label, _ = walkers(count=2)
    always = Weights.shipped()
    network = always["joins"]
    sure = Network(
        **{**vars(network), "out": 0 * network.out, "linear": 0 * network.linear, "bias": 9.0}
    )
    found = joined(
        label, sequence, described(sequence), measure(sequence),
        Weights({**always.networks, "joins": sure}), Joining(longest_gap=2.0), 25.0,
    )  # fmt: skip
    frame = sequence.frame
    for piece in np.unique(found):
        assert len(np.unique(frame[found == piece])) == (found == piece).sum()


def test_boxes_at_rest_undo_the_camera():
    sequence, *_ = walkers(count=2)
    steps = np.tile([1.0, 0.0, 0.0], (len(sequence.frames), 1))
    steps[1:] = [1.01, 0.2, -0.1]
    moved = sequence.box.copy()
    scale, shift = 1.0, np.zeros(2)
    for t in range(len(sequence.frames)):
        if t:
            scale, shift = 1.01 * scale, 1.01 * shift + [0.2, -0.1]
        rows = sequence.rows(t)
        moved[rows] *= scale
        moved[rows, :2] += shift
    seen = Sequence(**{**vars(sequence), "box": moved})
    assert at_rest(seen, steps) == pytest.approx(sequence.box)
