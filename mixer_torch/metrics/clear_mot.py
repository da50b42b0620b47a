"""CLEAR MOT (Bernardin and Stiefelhagen, EURASIP JIVP 2008), as MOTChallenge counts it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Int64

from mixer_torch.boxes import ROUNDING
from mixer_torch.metrics.overlaps import Overlaps

MOSTLY, HARDLY = 0.8, 0.2
"""Share of its boxes above which an object is mostly tracked, and below which mostly lost."""
KEEP = 1000
"""What keeping the identity of the step before gains, as in trackeval: more than overlaps can."""


def clear_sums(pairs: Overlaps, min_overlap: float) -> dict[str, Any]:
    """Counts of one sequence; those of sequences add up.

    Returns:
        ``TP``, ``FP``, ``FN``, ``IDSW``, ``Frag``, ``MT``, ``PT``, ``ML``, as
        :func:`mixer_torch.metrics.tracking.evaluate_tracks` explains them, and ``overlap``, the
        sum of the overlaps of the TP.
    """
    matched, seen = _matches(pairs, min_overlap)
    tp = int(matched.sum())
    true, found = pairs.truth, pairs.result
    order = np.lexsort((seen[matched], pairs.object[matched]))
    own, track, when = (x[matched][order] for x in (pairs.object, pairs.track, seen))
    same = own[1:] == own[:-1]
    share = np.bincount(own, minlength=len(true.count)) / true.count
    mostly, partly = int((share > MOSTLY).sum()), int((share >= HARDLY).sum())
    return {
        "TP": tp,
        "FP": len(found.step) - tp,
        "FN": len(true.step) - tp,
        "IDSW": int((same & (track[1:] != track[:-1])).sum()),
        "Frag": int((same & (when[1:] > when[:-1] + 1)).sum()),
        "MT": mostly,
        "PT": partly - mostly,
        "ML": len(true.count) - partly,
        "overlap": float(pairs.overlap[matched].sum()),
    }


def clear_ratios(sums: Mapping[str, Any]) -> dict[str, float]:
    """MOTA, which is 1 or less, and MOTP, the mean overlap; ratios of nothing are 0."""
    right, true = sums["TP"] - sums["FP"] - sums["IDSW"], sums["TP"] + sums["FN"]
    return {
        "MOTA": right / true if true else 0.0,
        "MOTP": sums["overlap"] / max(1, sums["TP"]),
    }


def _matches(
    pairs: Overlaps, min_overlap: float
) -> tuple[Bool[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Which pairs are matched, and the step of each, counting those with boxes on both sides.

    Step by step, as many objects as possible keep the identity that they had in the step before;
    then the sum of overlaps is greatest.
    """
    allowed = pairs.overlap >= min_overlap - ROUNDING
    both = (np.diff(pairs.truth.start) > 0) & (np.diff(pairs.result.start) > 0)
    steps, rank = np.flatnonzero(both), np.cumsum(both) - 1
    matched = allowed.copy()
    own, track = pairs.object, pairs.track
    held = np.full(len(pairs.truth.count), -1)
    for step in pairs.contested(allowed).tolist():
        rows = pairs.rows(step)
        held[:] = -1
        if rank[step] > 0:
            before = pairs.rows(int(steps[rank[step] - 1]))
            held[own[before][matched[before]]] = track[before][matched[before]]
        gain = KEEP * (held[own[rows]] == track[rows]) + pairs.overlap[rows]
        matched[rows] = pairs.assign_step(step, rows, np.where(allowed[rows], gain, 0))
    return matched, rank[pairs.step]
