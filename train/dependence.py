"""How dependent modalities are given the truth, and what each of them is worth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from mixer_torch.fusion import Fusion, LogOddsFusion
from mixer_torch.train.evaluation import solved
from mixer_torch.train.tables import PairTable


def dependence(tables: Sequence[PairTable], modalities: Sequence[str]) -> dict[str, Any]:
    """Correlation of log likelihood ratios among same pairs and among different pairs.

    Adding up log likelihood ratios is right where modalities are independent given the truth, so
    that these are all 0. A pair counts where both modalities have something to say.

    Args:
        tables: Their ``evidence`` is scores.
        modalities: Names of its rows.

    Returns:
        For ``same`` and ``different``, for each two modalities ``a and b``, the correlation; None
        where one of them does not vary.
    """
    ratio = torch.logit(torch.cat([table.evidence for table in tables], 1).double(), eps=1e-6)
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

    def mean_f1(rows: list[int], chosen: Fusion) -> float:
        names = [modalities[k] for k in rows]
        found = [solved(table, table.evidence[rows], names, chosen)["f1"] for table in tables]
        return sum(found) / len(found)

    every = list(range(len(modalities)))
    report = {"all": mean_f1(every, fusion)}
    for k in every if len(every) > 1 else []:
        rest = [row for row in every if row != k]
        weights = {modalities[row]: fusion.weights[modalities[row]] for row in rest}
        report[f"without {modalities[k]}"] = mean_f1(rest, LogOddsFusion(weights, fusion.cap))
    return report
