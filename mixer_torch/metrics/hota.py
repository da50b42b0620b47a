"""HOTA, higher order tracking accuracy (Luiten et al., IJCV 2021).

At each threshold alpha, boxes are matched frame by frame; DetA is the Jaccard index of true and
found boxes, AssA the mean over matched boxes c of A(c), the Jaccard index of the boxes of the two
identities that c joins, and HOTA the square root of DetA AssA. Each is averaged over alpha.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64

from mixer_torch.boxes import ROUNDING
from mixer_torch.metrics.overlaps import Overlaps

ALPHAS = np.arange(0.05, 0.99, 0.05)
"""Thresholds of intersection over union, as in the paper: 0.05, 0.1, ..., 0.95."""
NOTHING = 1e-10
"""Added up where no box is matched, so that the localisation of none is 1, as trackeval has it."""


def hota_sums(pairs: Overlaps) -> dict[str, Float64[np.ndarray, " alphas"]]:
    """Sums over the boxes of a sequence, for each threshold; those of sequences add up.

    Returns:
        ``TP``, ``FP``, ``FN`` boxes; over the TP, the sums of A(c) (``AssA``), of its recall and
        precision (``AssRe``, ``AssPr``) and of the overlap (``LocA``).
    """
    chosen = pairs.assign(_alignment(pairs) * pairs.overlap)
    overlap = pairs.overlap[chosen, None]
    matched = overlap >= ALPHAS - ROUNDING
    true, found = pairs.truth.count, pairs.result.count
    code = pairs.object[chosen] * max(len(found), 1) + pairs.track[chosen]
    joined, place = np.unique(code, return_inverse=True)
    together = np.stack(
        [np.bincount(place[of_alpha], minlength=len(joined)) for of_alpha in matched.T], 1
    )
    of_true, of_found = (true[joined // max(len(found), 1)], found[joined % max(len(found), 1)])
    either = of_true[:, None] + of_found[:, None] - together
    tp = matched.sum(0).astype(np.float64)
    return {
        "TP": tp,
        "FP": found.sum() - tp,
        "FN": true.sum() - tp,
        "AssA": (together**2 / either).sum(0),
        "AssRe": (together**2 / of_true[:, None]).sum(0),
        "AssPr": (together**2 / of_found[:, None]).sum(0),
        "LocA": (overlap * matched).sum(0),
    }


def hota_ratios(sums: Mapping[str, Float64[np.ndarray, " alphas"]]) -> dict[str, float]:
    """HOTA, DetA, AssA, DetRe, DetPr, AssRe, AssPr and LocA in [0, 1], means over thresholds."""
    tp, fp, fn = (sums[name] for name in ("TP", "FP", "FN"))
    matched = np.maximum(1, tp)
    det_a, ass_a = tp / np.maximum(1, tp + fn + fp), sums["AssA"] / matched
    ratios = {
        "HOTA": np.sqrt(det_a * ass_a),
        "DetA": det_a,
        "AssA": ass_a,
        "DetRe": tp / np.maximum(1, tp + fn),
        "DetPr": tp / np.maximum(1, tp + fp),
        "AssRe": sums["AssRe"] / matched,
        "AssPr": sums["AssPr"] / matched,
        "LocA": np.maximum(NOTHING, sums["LocA"]) / np.maximum(NOTHING, tp),
    }
    return {name: float(value.mean()) for name, value in ratios.items()}


def _alignment(pairs: Overlaps) -> Float64[np.ndarray, " k"]:
    """How well the two identities of each pair go together over the whole sequence.

    Each overlap counts by its share in those of both its boxes; the sum over the boxes of two
    identities, n, becomes a Jaccard index, n / (true + found - n).
    """
    of_true = np.bincount(pairs.true, pairs.overlap, len(pairs.truth.step))
    of_found = np.bincount(pairs.found, pairs.overlap, len(pairs.result.step))
    either = of_true[pairs.true] + of_found[pairs.found] - pairs.overlap
    share = np.divide(pairs.overlap, either, out=np.zeros_like(either), where=either > ROUNDING)
    code = pairs.object * len(pairs.result.count) + pairs.track
    _, place = np.unique(code, return_inverse=True)
    together = np.bincount(place, share)[place] if len(place) else share
    counts = pairs.truth.count[pairs.object] + pairs.result.count[pairs.track]
    return together / (counts - together)
