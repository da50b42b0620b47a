"""The text that commands print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from tabulate import tabulate

from mixer_torch.affinity import Affinity
from mixer_torch.association import Association
from mixer_torch.io.results import Result


def check_suffix(name: str, path: Path, *suffixes: str) -> None:
    """ValueError unless the file name of an option ends as it should."""
    if path.suffix not in suffixes:
        raise ValueError(f"{name}: expected a file name in {' or '.join(suffixes)}, got {path}")


def table(
    rows: Sequence[Sequence[str]], titles: Sequence[str] = (), left: int = 1, last: bool = False
) -> str:
    """A plain table; cells are shown as they are.

    Args:
        rows: Cells, row by row, at least one row.
        titles: Of the columns; none if empty.
        left: How many of the first columns are aligned to the left; others are to the right.
        last: Whether the last column is aligned to the left, too.
    """
    count = len(rows[0])
    sides = ["left" if k < left or (last and k == count - 1) else "right" for k in range(count)]
    text = tabulate(rows, titles, tablefmt="plain", disable_numparse=True, colalign=sides)
    return "\n".join(line.rstrip() for line in text.splitlines())


def size(affinity: Affinity) -> str:
    """Numbers of observations, views and pairs, and the names of the modalities."""
    views = len(torch.unique(affinity.view[affinity.view >= 0]))
    where = f"in {views:,} {'view' if views == 1 else 'views'}" if views else "of no view"
    modalities = ", ".join(affinity.modalities)
    pairs = affinity.pairs.shape[1]
    return f"{len(affinity):,} observations {where}, {pairs:,} pairs, {modalities}"


def clusters(association: Association) -> str:
    """The number of clusters, or of links where the solver gives no clusters."""
    if association.num_clusters is None:
        return f"{association.links.shape[1]:,} links"
    return f"{association.num_clusters:,} clusters"


def status(association: Association) -> list[str]:
    """The objective, with its gap to a proven bound if there is one, and why the solver ended."""
    bound = "" if association.gap is None else f" (gap {association.gap:.2%})"
    return [f"objective {association.objective:.6g}{bound}", f"status: {association.status.value}"]


def result_table(result: Result) -> str:
    """Metrics of each modality alone and of all, or numbers of clusters where there is no truth."""
    metrics = result.metrics()
    if metrics is not None:
        gallery = ("bcubed_f1", "rank1", "map") if "map" in metrics["all"] else ()
        return metrics_table(metrics, ("precision", "recall", "f1", *gallery))
    found = {**result.alone, "all": result.association}
    return table([[name, clusters(association)] for name, association in found.items()], left=2)


def metrics_table(metrics: Mapping[str, Any], columns: tuple[str, ...]) -> str:
    """One row for each modality alone, one for all, and the true number of clusters in the last."""
    shown = [name for name in columns if name in metrics["all"]]
    titles = ["F1" if name == "f1" else name.replace("_", " ") for name in shown]
    rows = [
        [name, *(f"{row[column]:.3f}" for column in shown), str(row.get("clusters", "-"))]
        for name, row in {**metrics.get("alone", {}), "all": metrics["all"]}.items()
    ]
    if "objects" in metrics["all"]:
        rows.append(["truth", *([""] * len(shown)), str(metrics["all"]["objects"])])
    return table(rows, ["", *titles, "clusters"])


def listing(out: Path, written: list[str]) -> list[str]:
    """The files that were written, each picture on a line of its own."""
    pictures = [name for name in written if name.endswith((".png", ".mp4"))]
    others = [name for name in written if name not in pictures]
    return [
        f"written to {out}: {', '.join(others)}",
        *(f"{'video' if name.endswith('.mp4') else 'picture'}: {out / name}" for name in pictures),
    ]
