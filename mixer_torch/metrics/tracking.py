"""How good tracks are against the truth: HOTA, IDF1, MOTA and the like, by the package trackeval.

The metrics are those of MOTChallenge: HOTA (Luiten et al., 2021), IDF1 (Ristani et al., 2016) and
CLEAR MOT (Bernardin and Stiefelhagen, 2008), as trackeval's metric classes compute them, here from
arrays instead of folders. Beside them stand pairwise and B-cubed scores
(:mod:`mixer_torch.metrics.clustering`) over the boxes that are matched to the truth, which say how good the
association alone is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64, Int64
from scipy.optimize import linear_sum_assignment

from mixer_torch.boxes import box_overlap
from mixer_torch.metrics.clustering import bcubed, pairwise
from mixer_torch.tracks import Tracks

RATIOS = {
    "HOTA": ("HOTA", "DetA", "AssA", "DetRe", "DetPr", "AssRe", "AssPr", "LocA"),
    "Identity": ("IDF1", "IDP", "IDR"),
    "CLEAR": ("MOTA", "MOTP"),
}
"""What is reported as a percentage, by the class of trackeval that computes it."""
COUNTS = {
    "TP": "CLR_TP",
    "FP": "CLR_FP",
    "FN": "CLR_FN",
    "IDSW": "IDSW",
    "Frag": "Frag",
    "MT": "MT",
    "PT": "PT",
    "ML": "ML",
}
"""What is reported as a number, and how trackeval's CLEAR calls it."""


def evaluate_tracks(result: Tracks, truth: Tracks, min_overlap: float = 0.5) -> dict[str, Any]:
    """All metrics of the tracks of one sequence.

    Boxes are as similar as their intersection over union. What is to be ignored in the truth has
    to be left out of both before (:class:`mixer_torch.io.tracks.MotTruth`). With several
    cameras an identity is one object in all of them, and time runs through one camera after the
    other, so that who is followed from one to the next counts as followed.

    Args:
        result: The tracks to measure.
        truth: The true tracks.
        min_overlap: Intersection over union from which a box is a true one, in (0, 1], for all
            metrics but HOTA, which averages over 0.05, 0.1, ..., 0.95.

    Returns:
        In percent: ``HOTA``, ``DetA``, ``AssA``, ``DetRe``, ``DetPr``, ``AssRe``, ``AssPr``,
        ``LocA``; ``IDF1``, ``IDP``, ``IDR``; ``MOTA``, ``MOTP``, which is the mean overlap; and,
        over the boxes that are matched frame by frame, whatever identity they were given,
        ``pairwise_precision``, ``pairwise_recall``, ``pairwise_f1``, ``bcubed_precision``,
        ``bcubed_recall``, ``bcubed_f1``. Numbers of: ``TP``, ``FP``, ``FN`` boxes; ``IDSW``,
        identity switches; ``Frag``, fragmentations; ``MT``, ``PT``, ``ML``, objects mostly (more
        than 80 % of their boxes), partly and hardly tracked (less than 20 %); ``tracks`` and
        ``objects``, in the result and the truth. Ratios of nothing are 0, as trackeval has them,
        except LocA, and pairwise and B-cubed, which are 100.

    Raises:
        ImportError: trackeval is not installed.
        ValueError: min_overlap is out of range.
    """
    return evaluate_sequences({"": result}, {"": truth}, min_overlap)["sequences"][""]


def evaluate_sequences(
    results: Mapping[str, Tracks], truths: Mapping[str, Tracks], min_overlap: float = 0.5
) -> dict[str, Any]:
    """All metrics of several sequences, of each and of all together.

    Together, boxes, matches and errors are added up over sequences before ratios are taken, as
    on MOTChallenge: a long sequence counts for more than a short one.

    Args:
        results: The tracks to measure, by the name of their sequence.
        truths: The true tracks, by the same names.
        min_overlap: As in :func:`evaluate_tracks`.

    Returns:
        ``{"combined": metrics, "sequences": {name: metrics}}``, each as :func:`evaluate_tracks`
        returns them; sequences in the order of the truth.

    Raises:
        ImportError: trackeval is not installed.
        ValueError: Names differ, there are none, or min_overlap is out of range.
    """
    _check(results, truths, min_overlap)
    scorers = _trackeval(min_overlap)
    raw: dict[str, dict[str, Any]] = {name: {} for name in scorers}
    sizes, matches = {}, {}
    for name in truths:
        data = _timesteps(results[name], truths[name])
        for metric, scorer in scorers.items():
            raw[metric][name] = scorer.eval_sequence(data)
        sizes[name] = {"tracks": data["num_tracker_ids"], "objects": data["num_gt_ids"]}
        matches[name] = _matches(data, min_overlap)
    together = {metric: scorers[metric].combine_sequences(raw[metric]) for metric in scorers}
    total = {key: sum(size[key] for size in sizes.values()) for key in ("tracks", "objects")}
    return {
        "combined": _summary(together) | total | _association(_side_by_side(matches.values())),
        "sequences": {
            name: _summary({metric: raw[metric][name] for metric in scorers})
            | sizes[name]
            | _association(matches[name])
            for name in truths
        },
    }


def _check(results: Mapping[str, Tracks], truths: Mapping[str, Tracks], min_overlap: float) -> None:
    if not 0 < min_overlap <= 1:
        raise ValueError(f"min_overlap: expected a value in (0, 1], got {min_overlap}")
    if not truths:
        raise ValueError("truths: expected one sequence or more, got none")
    if missing := [name for name in truths if name not in results]:
        raise ValueError(f"results: no tracks of {', '.join(missing)}, of which there is truth")
    if extra := [name for name in results if name not in truths]:
        raise ValueError(f"truths: no truth of {', '.join(extra)}, of which there are tracks")


def _trackeval(min_overlap: float) -> dict[str, Any]:
    """The metric classes of trackeval, which say nothing while they work."""
    try:
        from trackeval.metrics import CLEAR, HOTA, Identity
    except ImportError as error:
        raise ImportError(
            "tracking metrics need the package trackeval, which does not import "
            f'({error}): pip install "mixer-torch[tracking]"'
        ) from error
    return {
        "HOTA": HOTA(),
        "Identity": Identity({"THRESHOLD": min_overlap, "PRINT_CONFIG": False}),
        "CLEAR": CLEAR({"THRESHOLD": min_overlap, "PRINT_CONFIG": False}),
    }


def _timesteps(result: Tracks, truth: Tracks) -> dict[str, Any]:
    """What trackeval's metrics ask for: identities from 0 and similarities, step by step.

    A step is a frame of a camera. Frames in which there is nothing change no metric.
    """
    place = np.concatenate([np.stack([t.camera, t.frame], 1) for t in (truth, result)])
    step = np.unique(place, axis=0, return_inverse=True)[1].reshape(-1)
    steps = int(step.max()) + 1 if len(step) else 0
    data: dict[str, Any] = {"num_timesteps": steps}
    rows = {}
    for name, tracks, own in (
        ("gt", truth, step[: len(truth)]),
        ("tracker", result, step[len(truth) :]),
    ):
        unique, identity = np.unique(tracks.identity, return_inverse=True)
        order = np.argsort(own, kind="stable")
        rows[name] = np.split(order, np.searchsorted(own[order], np.arange(1, steps)))
        data[f"num_{name}_ids"], data[f"num_{name}_dets"] = len(unique), len(tracks)
        data[f"{name}_ids"] = [identity[row] for row in rows[name]]
    data["similarity_scores"] = [
        similarity(truth.box[true], result.box[found])
        for true, found in zip(rows["gt"], rows["tracker"], strict=True)
    ]
    return data


def similarity(
    a: Float64[np.ndarray, "a 4"], b: Float64[np.ndarray, "b 4"]
) -> Float64[np.ndarray, "a b"]:
    """Intersection over union of each box x1 y1 x2 y2 with each; 0 with a box of no area."""
    solid_a, solid_b = ((box[:, 2:] > box[:, :2]).all(1) for box in (a, b))
    overlap = np.zeros((len(a), len(b)))
    overlap[np.ix_(solid_a, solid_b)] = box_overlap(a[solid_a], b[solid_b])
    return overlap


def match(
    overlap: Float64[np.ndarray, "a b"], min_overlap: float
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """The one-to-one assignment of greatest total overlap, where a pair has min_overlap or more."""
    gain = np.where(overlap < min_overlap - np.finfo(float).eps, 0, overlap)
    row, column = linear_sum_assignment(gain, maximize=True)
    counts = gain[row, column] > 0
    return row[counts], column[counts]


def _matches(data: Mapping[str, Any], min_overlap: float) -> Int64[np.ndarray, "3 n"]:
    """Given identity, true identity and step of each box that is matched to the truth."""
    columns = [np.empty((3, 0), dtype=np.int64)]
    for step, overlap in enumerate(data["similarity_scores"]):
        true, found = match(overlap, min_overlap)
        given, identity = data["tracker_ids"][step][found], data["gt_ids"][step][true]
        columns.append(np.stack([given, identity, np.full(len(true), step)]))
    return np.concatenate(columns, 1)


def _side_by_side(matches: Any) -> Int64[np.ndarray, "3 n"]:
    """The matches of several sequences, which have no identity and no step in common."""
    columns, start = [np.empty((3, 0), dtype=np.int64)], np.zeros((3, 1), dtype=np.int64)
    for part in matches:
        columns.append(part + start)
        start = start + part.max(1, keepdims=True, initial=-1) + 1
    return np.concatenate(columns, 1)


def _association(matches: Int64[np.ndarray, "3 n"]) -> dict[str, float]:
    given, identity, step = torch.from_numpy(matches)
    pairs, cubed = pairwise(given, identity, step), bcubed(given, identity)
    return {
        **{f"pairwise_{key}": 100 * pairs[key] for key in ("precision", "recall", "f1")},
        **{key: 100 * value for key, value in cubed.items()},
    }


def _summary(raw: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    ratios = {
        field: 100 * float(np.mean(raw[metric][field]))
        for metric, fields in RATIOS.items()
        for field in fields
    }
    return ratios | {name: int(raw["CLEAR"][field]) for name, field in COUNTS.items()}
