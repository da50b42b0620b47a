from itertools import combinations, permutations

import numpy as np
import pytest

from mixer_torch.boxes import assign, corners, iou, match_boxes
from mixer_torch.io.motchallenge import read_table, read_truth
from mixer_torch.metrics.tracking import evaluate_sequences, evaluate_tracks
from mixer_torch.tracks import Tracks

RATIOS = {
    "HOTA", "DetA", "AssA", "DetRe", "DetPr", "AssRe", "AssPr", "LocA", "IDF1", "IDP", "IDR",
    "MOTA", "MOTP", "pairwise_precision", "pairwise_recall", "pairwise_f1", "bcubed_precision",
    "bcubed_recall", "bcubed_f1",
}  # fmt: skip
COUNTS = {"TP", "FP", "FN", "IDSW", "Frag", "MT", "PT", "ML", "tracks", "objects"}
NOTHING = Tracks([], [], [])


def tracks(*rows, **columns):
    """Rows of frame, identity, left: boxes 10 wide and 10 high."""
    frame, identity, left = np.array(rows).T
    box = np.stack([left, 0 * left, left + 10, 0 * left + 10], 1)
    return Tracks(frame, identity, box, **columns)


def scene(seed, frames=5, objects=3):
    """Objects far enough apart to tell and near enough to confuse, seen badly."""
    random = np.random.default_rng(seed)

    def draw(spread):
        rows = [
            (frame, identity, 4 * identity + spread * random.normal())
            for frame in range(frames)
            for identity in random.permutation(np.arange(1, objects + 1))
            if random.random() < 0.8
        ]
        found = np.array(rows).reshape(-1, 3)
        box = np.stack([found[:, 2], 0 * found[:, 2], found[:, 2] + 10, 0 * found[:, 2] + 10], 1)
        return found[:, 0].astype(int), found[:, 1].astype(int), box

    truth, result = Tracks(*draw(0.5)), draw(3)
    shuffled = np.concatenate(
        [random.permutation(objects)[: (result[0] == frame).sum()] for frame in range(frames)]
    )
    return Tracks(result[0], shuffled + 1, result[2]), truth


def test_perfect_tracks_have_full_marks_whatever_they_are_called():
    truth = tracks((1, 1, 0), (1, 2, 50), (2, 1, 3), (2, 2, 47), (4, 2, 40))
    metrics = evaluate_tracks(Tracks(truth.frame, 77 - truth.identity, truth.box), truth)
    assert set(metrics) == RATIOS | COUNTS
    assert all(metrics[name] == pytest.approx(100) for name in RATIOS)
    assert {name: metrics[name] for name in COUNTS} == {
        "TP": 5, "FP": 0, "FN": 0, "IDSW": 0, "Frag": 0, "MT": 2, "PT": 0, "ML": 0,
        "tracks": 2, "objects": 2,
    }  # fmt: skip


def test_an_identity_lost_half_way():
    truth = tracks(*((frame, 1, 0) for frame in range(1, 5)))
    result = tracks((1, 1, 0), (2, 1, 0), (3, 2, 0), (4, 2, 0))
    metrics = evaluate_tracks(result, truth)
    expected = {
        "DetA": 100,
        "AssA": 50,  # each box: 2 with its identity on both sides, of 4
        "HOTA": 100 * 0.5**0.5,
        "IDF1": 50,  # one of two halves counts
        "MOTA": 75,  # one switch in four boxes
        "IDSW": 1,
        "Frag": 0,
        "pairwise_precision": 100,
        "pairwise_recall": 100 / 3,  # 2 pairs of 6
        "bcubed_recall": 50,
        "bcubed_f1": 200 / 3,
    }
    assert {name: metrics[name] for name in expected} == pytest.approx(expected)


def test_a_box_that_lies_aside_by_half():
    metrics = evaluate_tracks(tracks((1, 1, 5)), tracks((1, 1, 0)))
    expected = {
        "HOTA": 600 / 19,  # overlap 1/3 is enough at 0.05, 0.1, ..., 0.3
        "LocA": 1500 / 19,  # 1/3 there, and 1 by convention where nothing matches
        "IDF1": 0,
        "MOTA": -100,  # (0 right - 1 wrong) / 1 true
        "FP": 1,
        "FN": 1,
        "ML": 1,
        "pairwise_f1": 100,  # nothing is matched, and nothing is wrong with that
    }
    assert {name: metrics[name] for name in expected} == pytest.approx(expected)
    lenient = evaluate_tracks(tracks((1, 1, 5)), tracks((1, 1, 0)), min_overlap=1 / 3)
    assert lenient["IDF1"] == lenient["MOTA"] == 100
    assert lenient["MOTP"] == pytest.approx(100 / 3)


def test_a_gap_is_a_fragmentation_and_no_switch():
    truth = tracks(*((frame, 1, 0) for frame in range(1, 4)), (2, 2, 90))
    metrics = evaluate_tracks(tracks((1, 5, 0), (2, 6, 90), (3, 5, 0)), truth)
    assert (metrics["IDSW"], metrics["Frag"], metrics["FN"]) == (0, 1, 1)
    assert (metrics["PT"], metrics["MT"]) == (1, 1)


def test_an_identity_is_followed_from_camera_to_camera():
    def seen(*identity):
        return tracks(
            *zip([1, 2, 1, 2], identity, [0, 3, 70, 73], strict=True), camera=[4, 4, 7, 7]
        )

    truth = seen(1, 1, 1, 1)
    assert evaluate_tracks(seen(3, 3, 3, 3), truth)["HOTA"] == pytest.approx(100)
    metrics = evaluate_tracks(seen(1, 1, 2, 2), truth)
    assert metrics["IDSW"] == 1
    assert metrics["IDF1"] == 50
    assert metrics["FP"] == 0


def test_nothing_found_and_nothing_there():
    truth = tracks((1, 1, 0), (2, 1, 0))
    assert evaluate_tracks(NOTHING, truth)["FN"] == 2
    assert evaluate_tracks(NOTHING, truth)["HOTA"] == 0
    assert evaluate_tracks(truth, NOTHING)["FP"] == 2
    assert evaluate_tracks(NOTHING, NOTHING)["objects"] == 0


@pytest.mark.parametrize("seed", range(12))
def test_idf1_is_that_of_the_best_of_all_pairings_of_identities(seed):
    result, truth = scene(seed)
    both = np.zeros((4, 4), dtype=int)
    for i, j in np.argwhere(iou(truth.box, result.box) >= 0.5):
        if truth.frame[i] == result.frame[j]:
            both[truth.identity[i], result.identity[j]] += 1
    best = max(both[range(1, 4), list(order)].sum() for order in permutations(range(1, 4)))
    metrics = evaluate_tracks(result, truth)
    assert 0 < best < len(truth)
    assert metrics["IDF1"] == pytest.approx(200 * best / (len(truth) + len(result)))
    assert metrics["IDR"] == pytest.approx(100 * best / len(truth))
    assert metrics["IDP"] == pytest.approx(100 * best / len(result))


def clear_by_enumeration(result, truth):
    """TP, IDSW and the sum of overlaps of CLEAR MOT, frame by frame over all ways to match.

    First as many as possible keep who they had in the frame before, then overlap decides.
    """
    last, before, matched, switches, total = {}, {}, 0, 0, 0.0
    for frame in np.union1d(truth.frame, result.frame):
        true, found = truth.select(truth.frame == frame), result.select(result.frame == frame)
        if not (len(true) and len(found)):
            continue
        overlap = iou(true.box, found.box)
        allowed = [(i, j) for i, j in np.argwhere(overlap >= 0.5)]
        ways = [
            way
            for size in range(min(len(true), len(found)) + 1)
            for way in combinations(allowed, size)
            if len({i for i, _ in way}) == len({j for _, j in way}) == size
        ]

        def kept(way, before=before, true=true, found=found, overlap=overlap):
            same = sum(before.get(true.identity[i]) == found.identity[j] for i, j in way)
            return same, sum(overlap[i, j] for i, j in way)

        best = max(ways, key=kept)
        pairs = {true.identity[i]: found.identity[j] for i, j in best}
        switches += sum(last.get(mine, theirs) != theirs for mine, theirs in pairs.items())
        matched, total = matched + len(best), total + kept(best)[1]
        before = pairs
        last |= pairs
    return matched, switches, total


@pytest.mark.parametrize("seed", range(12))
def test_mota_and_switches_are_those_of_an_enumeration(seed):
    result, truth = scene(seed)
    matched, switches, total = clear_by_enumeration(result, truth)
    metrics = evaluate_tracks(result, truth)
    assert (metrics["TP"], metrics["IDSW"]) == (matched, switches)
    false = len(result) - matched
    assert (metrics["FP"], metrics["FN"]) == (false, len(truth) - matched)
    assert metrics["MOTA"] == pytest.approx(100 * (matched - false - switches) / len(truth))
    assert metrics["MOTP"] == pytest.approx(100 * total / matched)
    assert switches > 0


def test_together_is_as_if_one_sequence_followed_the_other():
    results, truths = zip(*(scene(seed, frames=3 + seed) for seed in range(4)), strict=True)

    def joined(parts):
        return Tracks(
            np.concatenate([part.frame + 100 * k for k, part in enumerate(parts)]),
            np.concatenate([part.identity + 10 * k for k, part in enumerate(parts)]),
            np.concatenate([part.box for part in parts]),
        )

    names = "abcd"
    metrics = evaluate_sequences(
        dict(zip(reversed(names), reversed(results), strict=True)),
        dict(zip(names, truths, strict=True)),
    )
    assert metrics["combined"] == pytest.approx(evaluate_tracks(joined(results), joined(truths)))
    assert list(metrics["sequences"]) == list(names)
    for name, result, truth in zip(names, results, truths, strict=True):
        assert metrics["sequences"][name] == evaluate_tracks(result, truth)


def test_boxes_without_area_are_like_nothing():
    box = np.array([[0, 0, 10, 10], [3, 3, 3, 3], [5, 5, 4, 4.0]])
    expected = np.zeros((3, 3))
    expected[0, 0] = 1
    np.testing.assert_array_equal(iou(box, box), expected)


def test_matches_are_of_greatest_total_overlap():
    row, column = assign(np.array([[0.9, 0.8], [0.8, 0.4]]), 0.5)
    assert list(zip(row, column, strict=True)) == [(0, 1), (1, 0)]
    assert not len(assign(np.zeros((2, 0)), 0.5)[0])


@pytest.mark.parametrize(
    ("results", "truths", "message"),
    [
        ({}, {"a": NOTHING}, "results: no tracks of a"),
        ({"a": NOTHING, "b": NOTHING}, {"a": NOTHING}, "truths: no truth of b"),
        ({}, {}, "truths: expected one sequence or more"),
    ],
)
def test_sequences_that_do_not_fit_are_named(results, truths, message):
    with pytest.raises(ValueError, match=message):
        evaluate_sequences(results, truths)


@pytest.mark.parametrize("min_overlap", [0, 1.5, float("nan")])
def test_an_overlap_out_of_range_is_named(min_overlap):
    with pytest.raises(ValueError, match=r"min_overlap: expected a value in \(0, 1\]"):
        evaluate_tracks(NOTHING, NOTHING, min_overlap)


def read(folder):
    """Detections and truth of a sequence, as tables."""
    return read_table(folder / "det" / "det.txt")[0], read_truth(folder / "gt" / "gt.txt")


def as_tracks(rows):
    return Tracks(rows[:, 0].astype(int), rows[:, 1].astype(int), corners(rows[:, 2:6]))


@pytest.mark.real_data
def test_the_truth_given_to_the_detections_has_the_known_figures(real_data):
    results, truths = {}, {}
    for folder in sorted((real_data / "mot15").iterdir()):
        rows, truth = read(folder)
        mine, theirs = match_boxes(
            rows[:, 0], corners(rows[:, 2:6]), truth[:, 0], corners(truth[:, 2:6])
        )
        rows[mine, 1] = truth[theirs, 1]
        results[folder.name], truths[folder.name] = as_tracks(rows[mine]), as_tracks(truth)
    metrics = evaluate_sequences(results, truths)["combined"]
    assert metrics["HOTA"] == pytest.approx(52.3, abs=0.05)
    assert metrics["AssA"] == pytest.approx(56.4, abs=0.05)
    # 83.0 was had by an assignment of all boxes, of which pairs under 0.5 were left out after.
    assert metrics["IDF1"] == pytest.approx(83.0, abs=0.1)
    assert metrics["IDP"] == metrics["pairwise_f1"] == 100


@pytest.mark.real_data
def test_sort_has_the_known_figures(real_data):
    trackers = pytest.importorskip("trackers")
    supervision = pytest.importorskip("supervision")
    results, truths = {}, {}
    for folder in sorted((real_data / "mot15").iterdir()):
        detections, truth = read(folder)
        tracker, rows = trackers.SORTTracker(), []
        for frame in range(1, int(truth[:, 0].max()) + 1):
            now = detections[detections[:, 0] == frame]
            seen = supervision.Detections(
                corners(now[:, 2:6]).astype(np.float32), confidence=now[:, 6].astype(np.float32)
            )
            found = tracker.update(seen)
            known = found.tracker_id >= 0
            places = found.xyxy[known], found.tracker_id[known] + 1
            rows += [(frame, identity, box) for box, identity in zip(*places, strict=True)]
        results[folder.name] = Tracks(*(np.array(column) for column in zip(*rows, strict=True)))
        truths[folder.name] = as_tracks(truth)
    metrics = evaluate_sequences(results, truths)["combined"]
    found = [metrics[name] for name in ("HOTA", "AssA", "IDF1")]
    assert found == pytest.approx([39.2, 36.8, 51.5], abs=0.06)
