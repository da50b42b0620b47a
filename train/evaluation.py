"""What training improved: calibration of each modality, and F1 after solving."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from mixer_torch.affinity import Affinity
from mixer_torch.fusion import Fusion
from mixer_torch.io.files import write_json
from mixer_torch.metrics.calibration import calibration_metrics
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.scorers.likelihood_ratio import log_ratio_of
from mixer_torch.solvers.base import solve
from mixer_torch.train.pictures import histograms_figure, reliability_figure, save
from mixer_torch.train.tables import PairTable

Affinities = Mapping[str, tuple[Callable[[PairTable], Tensor], Fusion | None]]
"""By name of what is compared: scores (l, P) of a table, and the fusion that goes with them."""


def evaluate_scores(
    folder: Path,
    tables: Sequence[PairTable],
    modalities: Sequence[str],
    compared: Affinities,
) -> dict[str, Any]:
    """Measure several ways of scoring on the same pairs; write ``metrics.json`` and pictures.

    Args:
        folder: Where to; it is made if it is not there.
        tables: One a sequence.
        modalities: Names of the rows of evidence.
        compared: What is compared, the first being what the others are measured against.

    Returns:
        For each of the compared: by modality what ``calibration_metrics`` gives, over the pairs on
        which the modality has evidence; and ``f1``, precision and recall of each sequence solved.
    """
    folder.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {}
    ratios: dict[str, dict[str, tuple[Tensor, Tensor]]] = {}
    for name, (scores_of, fusion) in compared.items():
        scored = [scores_of(table) for table in tables]
        names = modalities if len(scored[0]) == len(modalities) else ["all"]
        ratios[name] = ratios_by_modality(tables, scored, names)
        results[name] = {
            "modalities": {key: calibration_metrics(*value) for key, value in ratios[name].items()},
            "sequences": [
                solved(table, scores, names, fusion)
                for table, scores in zip(tables, scored, strict=True)
            ],
        }
        f1 = [row["f1"] for row in results[name]["sequences"]]
        results[name]["f1"] = sum(f1) / len(f1)
    write_json(folder / "metrics.json", results)
    save(reliability_figure(ratios), folder / "reliability.png")
    save(histograms_figure(ratios), folder / "histograms.png")
    return results


def ratios_by_modality(
    tables: Sequence[PairTable], scored: Sequence[Tensor], names: Sequence[str]
) -> dict[str, tuple[Tensor, Tensor]]:
    """Log likelihood ratios and truth of the pairs on which a modality has evidence."""
    found = {}
    for k, name in enumerate(names):
        known = [
            table.known[k] if len(names) == len(table.evidence) else torch.ones_like(table.same)
            for table in tables
        ]
        score = torch.cat([s[k][kept] for s, kept in zip(scored, known, strict=True)])
        same = torch.cat([t.same[kept] for t, kept in zip(tables, known, strict=True)])
        if 0 < int(same.sum()) < len(same):
            found[name] = log_ratio_of(score), same
    return found


def solved(
    table: PairTable, scores: Tensor, names: Sequence[str], fusion: Fusion | None
) -> dict[str, float]:
    """Precision, recall and F1 of the solved problem, over the observations that are in pairs.

    Where the graph of pairs has several connected components (the frames 1, 21, 41, ... and
    2, 22, 42, ... of a video, by :class:`~mixer_torch.train.selectors.AtGaps` of 20), each is a
    problem by itself: that an object is not joined across components is no error.
    """
    place, part = torch.unique(table.pairs, return_inverse=True)
    view, identity = (x[place] for x in (table.observations.view, table.observations["identity"]))
    affinity = Affinity(part, scores, view, tuple(names))
    whole = components_of(part, len(place)) * (int(identity.max()) + 1 if len(identity) else 1)
    told_apart = torch.where(identity >= 0, identity + whole, identity)
    metrics = evaluate(solve(affinity, None, fusion), told_apart, view)
    return {key: metrics[key] for key in ("precision", "recall", "f1")}


def mean_f1(tables: Sequence[PairTable], modalities: Sequence[str], fusion: Fusion | None) -> float:
    """Mean F1 of solved sequences whose evidence is scores."""
    found = [solved(table, table.evidence, modalities, fusion)["f1"] for table in tables]
    return sum(found) / len(found)


def components_of(pairs: Int64[Tensor, "2 P"], count: int) -> Int64[Tensor, " m"]:
    """The number of the connected component of the graph of pairs of each observation."""
    ones = np.ones(pairs.shape[1], dtype=np.int8)
    graph = coo_array((ones, tuple(pairs.cpu().numpy())), shape=(count, count))
    return torch.from_numpy(connected_components(graph, directed=False)[1]).long()


def summary(results: Mapping[str, Any]) -> str:
    """A table of the results, for people."""
    lines = [
        "| | modality | Cllr | min Cllr | ECE | Brier | AUC |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, result in results.items():
        for modality, row in result["modalities"].items():
            cells = [f"{row[key]:.3f}" for key in ("cllr", "min_cllr", "ece", "brier", "auc")]
            lines.append(f"| {name} | {modality} | " + " | ".join(cells) + " |")
    lines += ["", "| | F1 after solving |", "|---|---|"]
    lines += [f"| {name} | {result['f1']:.3f} |" for name, result in results.items()]
    return "\n".join(lines)
