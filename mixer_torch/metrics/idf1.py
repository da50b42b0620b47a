"""IDF1, the F1 score of identities (Ristani et al., ECCV workshops 2016)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linear_sum_assignment

from mixer_torch.metrics.overlaps import Overlaps


def idf1_sums(pairs: Overlaps, min_overlap: float) -> dict[str, int]:
    """True positives, false positives and false negatives of one sequence; they add up.

    Of all one-to-one pairings of true and given identities the best counts: that with most boxes
    that overlap by ``min_overlap`` or more.
    """
    near = pairs.overlap >= min_overlap
    objects, own = np.unique(pairs.object[near], return_inverse=True)
    tracks, given = np.unique(pairs.track[near], return_inverse=True)
    together = np.bincount(own * len(tracks) + given, minlength=len(objects) * len(tracks))
    together = together.reshape(len(objects), len(tracks))
    matched = int(together[linear_sum_assignment(together, maximize=True)].sum())
    true, found = len(pairs.truth.step), len(pairs.result.step)
    return {"TP": matched, "FP": found - matched, "FN": true - matched}


def idf1_ratios(sums: Mapping[str, int]) -> dict[str, float]:
    """IDF1, IDP (precision) and IDR (recall) in [0, 1]; ratios of nothing are 0."""
    tp, fp, fn = (sums[name] for name in ("TP", "FP", "FN"))
    return {
        "IDF1": tp / max(1, tp + 0.5 * fp + 0.5 * fn),
        "IDP": tp / max(1, tp + fp),
        "IDR": tp / max(1, tp + fn),
    }
