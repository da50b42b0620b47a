"""How good tracks are against the truth: HOTA, IDF1, MOTA and the like.

The metrics are those of MOTChallenge, one a file (:mod:`~mixer_torch.metrics.hota`,
:mod:`~mixer_torch.metrics.idf1`, :mod:`~mixer_torch.metrics.clear_mot`), and equal what the package
trackeval computes. Beside them stand pairwise and B-cubed scores
(:mod:`mixer_torch.metrics.clustering`) over the boxes that are matched to the truth, which say how
good the association alone is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64

from mixer_torch.boxes import ROUNDING, check_min_overlap
from mixer_torch.metrics.clear_mot import clear_ratios, clear_sums
from mixer_torch.metrics.clustering import bcubed, pairwise
from mixer_torch.metrics.hota import hota_ratios, hota_sums
from mixer_torch.metrics.idf1 import idf1_ratios, idf1_sums
from mixer_torch.metrics.overlaps import Overlaps, overlaps
from mixer_torch.tracks import Tracks

RATIOS: dict[str, Callable[[Mapping[str, Any]], dict[str, float]]] = {
    "HOTA": hota_ratios,
    "Identity": idf1_ratios,
    "CLEAR": clear_ratios,
}
COUNTS = ("TP", "FP", "FN", "IDSW", "Frag", "MT", "PT", "ML")
"""Of CLEAR MOT."""


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
        ValueError: Names differ, there are none, or min_overlap is out of range.
    """
    _check(results, truths, min_overlap)
    sums: dict[str, dict[str, dict[str, Any]]] = {}
    sizes, matches = {}, {}
    for name in truths:
        pairs = overlaps(results[name], truths[name])
        sums[name] = {
            "HOTA": hota_sums(pairs),
            "Identity": idf1_sums(pairs, min_overlap),
            "CLEAR": clear_sums(pairs, min_overlap),
        }
        sizes[name] = {"tracks": len(pairs.result.count), "objects": len(pairs.truth.count)}
        matches[name] = _matches(pairs, min_overlap)
    together = {metric: _added([sums[name][metric] for name in truths]) for metric in RATIOS}
    return {
        "combined": _summary(together)
        | _added(list(sizes.values()))
        | _association(_side_by_side(list(matches.values()))),
        "sequences": {
            name: _summary(sums[name]) | sizes[name] | _association(matches[name])
            for name in truths
        },
    }


def _check(results: Mapping[str, Tracks], truths: Mapping[str, Tracks], min_overlap: float) -> None:
    check_min_overlap(min_overlap)
    if not truths:
        raise ValueError("truths: expected one sequence or more, got none")
    if missing := [name for name in truths if name not in results]:
        raise ValueError(f"results: no tracks of {', '.join(missing)}, of which there is truth")
    if extra := [name for name in results if name not in truths]:
        raise ValueError(f"truths: no truth of {', '.join(extra)}, of which there are tracks")


def _added(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {key: sum(part[key] for part in parts) for key in parts[0]}


def _matches(pairs: Overlaps, min_overlap: float) -> Int64[np.ndarray, "3 n"]:
    """Given identity, true identity and step of each box that is matched to the truth."""
    allowed = pairs.overlap >= min_overlap - ROUNDING
    chosen = pairs.assign(np.where(allowed, pairs.overlap, 0))
    return np.stack([pairs.track, pairs.object, pairs.step])[:, chosen]


def _side_by_side(matches: Sequence[Int64[np.ndarray, "3 _"]]) -> Int64[np.ndarray, "3 n"]:
    """The matches of several sequences, which have no identity and no step in common."""
    columns, start = [], np.zeros((3, 1), dtype=np.int64)
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


def _summary(sums: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    ratios = {
        name: 100 * value
        for metric, of_sums in RATIOS.items()
        for name, value in of_sums(sums[metric]).items()
    }
    return ratios | {name: sums["CLEAR"][name] for name in COUNTS}
