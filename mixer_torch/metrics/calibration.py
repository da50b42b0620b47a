"""How well scores keep their promise that LR / (1 + LR) is what they say.

All functions take log likelihood ratios r (P,) in nats, logit of the scores, and whether each pair
shows one object, (P,) bool. They take both kinds of pairs to be equally likely (prior 0.5), at
whatever rate they occur: each kind is averaged by itself.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import softplus


def calibration_metrics(log_ratio: Tensor, same: Tensor, bins: int = 15) -> dict[str, float]:
    """All figures of this file: ``cllr``, ``min_cllr``, ``log_loss``, ``brier``, ``ece``, ``auc``.

    Args:
        log_ratio: (P,) log likelihood ratios, nats.
        same: (P,) bool.
        bins: Of the expected calibration error.

    Raises:
        ValueError: Lengths differ, a value is not finite, or one of the two kinds is missing.
    """
    ratio, same = checked(log_ratio, same)
    return {
        "cllr": cllr(ratio, same),
        "min_cllr": min_cllr(ratio, same),
        "log_loss": cllr(ratio, same) * math.log(2),
        "brier": brier(ratio, same),
        "ece": expected_calibration_error(ratio, same, bins),
        "auc": area_under_roc(ratio, same),
    }


def checked(log_ratio: Tensor, same: Tensor) -> tuple[Tensor, Tensor]:
    """Both as flat tensors, float64 and bool; ValueError where they are not what is wanted."""
    ratio = torch.as_tensor(log_ratio).detach().double().flatten()
    same = torch.as_tensor(same).to(ratio.device, torch.bool).flatten()
    if ratio.shape != same.shape:
        raise ValueError(f"same: expected one for each of {len(ratio)} ratios, got {len(same)}")
    if not bool(ratio.isfinite().all()):
        raise ValueError("log_ratio: expected finite values, got NaN or infinity")
    if not 0 < int(same.sum()) < len(same):
        raise ValueError(
            f"same: expected pairs of both kinds, got {int(same.sum())} same of {len(same)}"
        )
    return ratio, same


def cllr(log_ratio: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> float:
    """Cost of the log likelihood ratio, bits (Brümmer and du Preez 2006).

    1/2 mean over same of log2(1 + e^-r) + 1/2 mean over different of log2(1 + e^r). Saying nothing
    (r = 0) costs 1.
    """
    of_same = softplus(-log_ratio[same]).mean()
    of_different = softplus(log_ratio[~same]).mean()
    return float((of_same + of_different) / (2 * math.log(2)))


def min_cllr(log_ratio: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> float:
    """Cllr after the best monotone recalibration: what discrimination alone leaves to pay, bits."""
    posterior, weight, place = _pooled(log_ratio, same)
    p = posterior[place].clip(1e-300, 1)
    q = (1 - posterior[place]).clip(1e-300, 1)
    loss = -np.where(same.cpu().numpy(), np.log2(p), np.log2(q))
    return float((weight * loss).sum())


def _pooled(log_ratio: Tensor, same: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Isotonic posterior at prior 0.5 of each distinct ratio, weights of pairs, place of pairs."""
    from scipy.optimize import isotonic_regression

    value, place = np.unique(log_ratio.cpu().numpy(), return_inverse=True)
    hit = same.cpu().numpy()
    weight = np.where(hit, 0.5 / hit.sum(), 0.5 / (~hit).sum())
    total = np.bincount(place, weight, len(value))
    hits = np.bincount(place[hit], weight[hit], len(value))
    return isotonic_regression(hits / total, weights=total).x, weight, place


def brier(log_ratio: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> float:
    """Mean squared error of the scores at prior 0.5; saying nothing costs 0.25."""
    error = (torch.sigmoid(log_ratio) - same.double()).square()
    return float((error[same].mean() + error[~same].mean()) / 2)


def expected_calibration_error(
    log_ratio: Float[Tensor, " P"], same: Bool[Tensor, " P"], bins: int = 15
) -> float:
    """Mean distance of score and share of same pairs, at prior 0.5, over bins of equal width."""
    table = reliability(log_ratio, same, bins)
    return float((table["weight"] * (table["score"] - table["share"]).abs()).sum())


def reliability(
    log_ratio: Float[Tensor, " P"], same: Bool[Tensor, " P"], bins: int = 15
) -> dict[str, Any]:
    """What a reliability diagram shows of each bin of scores that is not empty.

    Returns:
        ``score``, the mean; ``share`` of same pairs at prior 0.5; ``weight``, the share of all
        pairs at prior 0.5; ``count`` of pairs.
    """
    score = torch.sigmoid(log_ratio)
    weight = torch.where(same, 0.5 / same.sum(), 0.5 / (~same).sum()).to(score)
    place = (score * bins).long().clamp(max=bins - 1)
    total = torch.zeros(bins).to(weight).index_add_(0, place, weight)
    hits = torch.zeros_like(total).index_add_(0, place, weight * same)
    mean = torch.zeros_like(total).index_add_(0, place, weight * score)
    used = total > 0
    return {
        "score": mean[used] / total[used],
        "share": hits[used] / total[used],
        "weight": total[used],
        "count": torch.bincount(place, minlength=bins)[used],
    }


def roc(
    log_ratio: Float[Tensor, " P"], same: Bool[Tensor, " P"]
) -> tuple[Float[Tensor, " k"], Float[Tensor, " k"]]:
    """False and true positive rates as the threshold falls, from (0, 0) to (1, 1)."""
    value, place = torch.unique(log_ratio, return_inverse=True)
    hits = torch.bincount(place[same], minlength=len(value)).double().flip(0).cumsum(0)
    false = torch.bincount(place[~same], minlength=len(value)).double().flip(0).cumsum(0)
    start = hits.new_zeros(1)
    return torch.cat([start, false / false[-1]]), torch.cat([start, hits / hits[-1]])


def area_under_roc(log_ratio: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> float:
    """Probability that a same pair has the larger ratio, ties counted as one half."""
    false, true = roc(log_ratio, same)
    return float(torch.trapezoid(true, false))
