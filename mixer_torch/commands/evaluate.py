"""`mixer evaluate`: measure a result, ours or someone else's, against the truth."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from mixer_torch.association import Association, Status
from mixer_torch.commands.sequences import measure_tracks, tracks_table
from mixer_torch.commands.text import check_suffix, metrics_table
from mixer_torch.datasets.base import Dataset
from mixer_torch.io.files import write_json
from mixer_torch.io.results import known_identity, read_labels
from mixer_torch.metrics.clustering import evaluate as measure

SHOWN = ("precision", "recall", "f1", "bcubed_f1", "adjusted_rand")


def evaluate(
    result: Path,
    truth: Path | None = None,
    dataset: Dataset | None = None,
    classes: list[int] = [1],  # noqa: B006
    min_overlap: float = 0.5,
    out: Path | None = None,
) -> str:
    """Measure tracks, or an association, against the truth.

    Tracks are measured as MOTChallenge measures them (HOTA, IDF1, MOTA, ...), in percent, and by
    pairs and B-cubed over the boxes that are matched to the truth.

    Args:
        result: Tracks: a file of MOTChallenge (txt), in the style of COCO (json), or with columns
            frame, identity, x1, y1, x2, y2 (csv or parquet); or a folder with one such file for
            each sequence, called after it; or a folder that `mixer associate` wrote. Or an
            association: associations.csv as `mixer associate` writes it, any CSV with a column
            `label` (and `observation`, the number of the row of the dataset), or npz.
        truth: Of tracks: the folder of a sequence of MOTChallenge, with gt/gt.txt; a folder of
            such folders; or a file like those of results. Boxes of classes that are not to be
            found are left out as on MOTChallenge.
        dataset: Source of the truth if there is no --truth. For an association without
            either it is in the CSV's columns `identity` and `view`.
        classes: Classes to find, in truth of MOT16 and later, which has classes.
        min_overlap: Of tracks: least intersection over union at which a box matches a true one.
        out: File to write the metrics to (json); if null, they are only printed.
    """
    if out is not None:
        check_suffix("out", out, ".json")
    if not result.exists():
        raise FileNotFoundError(f"result: {result} does not exist")
    if truth is None and _is_association(result):
        metrics = {"all": _measure_association(result, dataset)}
        lines = [metrics_table(metrics, SHOWN)]
    else:
        metrics = measure_tracks(result, truth, dataset, classes, min_overlap)
        lines = [tracks_table(metrics)]
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_json(out, metrics)
        lines.append(f"written: {out}")
    return "\n".join(lines)


def _is_association(result: Path) -> bool:
    """Whether a file holds labels of observations, or lacks the columns of tracks."""
    if result.suffix == ".npz":
        return True
    if result.suffix != ".csv":
        return False
    with result.open(newline="", encoding="utf-8-sig") as file:
        header = {name.strip() for name in next(csv.reader(file), [])}
    return "label" in header or not {"frame", "identity", "x1"} <= header


def _measure_association(result: Path, dataset: Dataset | None) -> dict[str, Any]:
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
    return measure(association, identity, view)


def _labelled(table: Mapping[str, torch.Tensor], m: int) -> Association:
    """The association of a table of labels, whose rows may be in any order."""
    labels = table["label"]
    if len(labels) != m:
        raise ValueError(f"result: expected {m} rows, one an observation, got {len(labels)}")
    if "observation" in table:
        order = table["observation"].argsort()
        if not torch.equal(table["observation"][order], torch.arange(m)):
            raise ValueError(f"result: expected each observation 0..{m - 1} once in its column")
        labels = labels[order]
    return Association(labels, float("nan"), Status.CONVERGED)
