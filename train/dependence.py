"""How dependent modalities are given the truth, and what each adds to the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from mixer_torch.fusion import LogOddsFusion
from mixer_torch.scorers.likelihood_ratio import log_ratio_of
from mixer_torch.train.evaluation import mean_f1
from mixer_torch.train.tables import PairTable


def dependence(tables: Sequence[PairTable], modalities: Sequence[str]) -> dict[str, Any]:
    """Correlation of log likelihood ratios among same pairs and among different pairs.

    Adding up log likelihood ratios is right where modalities are independent given the truth, so
    that these are all 0. Only pairs with evidence of both modalities count.

    Args:
        tables: Their ``evidence`` is scores.
        modalities: Names of its rows.

    Returns:
        For ``same`` and ``different``, for each two modalities ``a and b``, the correlation; None
        where one of them does not vary.
    """
    ratio = log_ratio_of(torch.cat([table.evidence for table in tables], 1))
    same = torch.cat([table.same for table in tables])
    report: dict[str, Any] = {}
    for kind, kept in (("same", same), ("different", ~same)):
        report[kind] = {
            f"{modalities[a]} and {modalities[b]}": _correlation(ratio[a, kept], ratio[b, kept])
            for a in range(len(modalities))
            for b in range(a + 1, len(modalities))
        }
    return report


def _correlation(a: Tensor, b: Tensor) -> float | None:
    says = (a != 0) & (b != 0)
    a, b = a[says], b[says]
    if len(a) < 3 or float(a.std()) == 0 or float(b.std()) == 0:
        return None
    return float(torch.corrcoef(torch.stack([a, b]))[0, 1])


def worth(
    tables: Sequence[PairTable], modalities: Sequence[str], fusion: LogOddsFusion
) -> dict[str, float]:
    """F1 after solving with ``all`` modalities, and ``without`` each of them."""
    report = {"all": mean_f1(tables, modalities, fusion)}
    every = range(len(modalities))
    for k in every if len(every) > 1 else ():
        rest = [row for row in every if row != k]
        names = [modalities[row] for row in rest]
        weights = {name: fusion.weights[name] for name in names}
        remaining = [replace(table, evidence=table.evidence[rest]) for table in tables]
        found = mean_f1(remaining, names, LogOddsFusion(weights, fusion.cap))
        report[f"without {modalities[k]}"] = found
    return report
