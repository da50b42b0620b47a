"""Measure a result, ours or someone else's, against the truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch

from mixer_torch.association import Association, Status
from mixer_torch.commands.text import check_suffix, metrics_table
from mixer_torch.datasets.base import Dataset
from mixer_torch.metrics import evaluate as measure
from mixer_torch.outputs import known_identity, read_labels, write_json


def evaluate(result: Path, dataset: Dataset | None = None, out: Path | None = None) -> str:
    """Measure an association against the truth.

    Args:
        result: associations.csv as `mixer associate` writes it, any CSV with a column `label` (and
            `observation`, the number of the row of the dataset), or an association in npz.
        dataset: Where the truth comes from. Where there is none, it is in the CSV's columns
            `identity` and `view`.
        out: File to write the metrics to (json); only printed if there is none.
    """
    if out is not None:
        check_suffix("out", out, ".json")
    table = {} if result.suffix == ".npz" else read_labels(result)
    if dataset is not None:
        observations = dataset.load()
        identity, view = known_identity(observations), observations.view
        if identity is None:
            raise ValueError("dataset: expected known identities (a feature 'identity'), got none")
    elif {"identity", "view"} <= set(table):
        identity, view = table["identity"], table["view"]
    else:
        raise ValueError(
            f"dataset: expected one, as {result} has no columns 'identity' and 'view' to take the "
            "truth from"
        )
    association = _labelled(table, len(view)) if table else Association.load(result)
    metrics = {"all": measure(association, identity, view)}
    lines = [metrics_table(metrics, ("precision", "recall", "f1", "bcubed_f1", "adjusted_rand"))]
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_json(out, metrics)
        lines.append(f"written: {out}")
    return "\n".join(lines)


def _labelled(table: Mapping[str, torch.Tensor], m: int) -> Association:
    """The association of a table whose rows may be in any order."""
    labels = table["label"]
    if len(labels) != m:
        raise ValueError(f"result: expected {m} rows, one an observation, got {len(labels)}")
    if "observation" in table:
        order = table["observation"].argsort()
        if not torch.equal(table["observation"][order], torch.arange(m)):
            raise ValueError(f"result: expected each observation 0..{m - 1} once in its column")
        labels = labels[order]
    return Association(labels, float("nan"), Status.CONVERGED)
