"""How results read on a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from mixer_torch.affinity import Affinity
from mixer_torch.association import Association
from mixer_torch.io.results import Result


def check_suffix(name: str, path: Path, *suffixes: str) -> None:
    """ValueError unless the file name of an option ends as it should."""
    if path.suffix not in suffixes:
        raise ValueError(f"{name}: expected a file name in {' or '.join(suffixes)}, got {path}")


def size(affinity: Affinity) -> str:
    """How much was compared."""
    views = len(torch.unique(affinity.view[affinity.view >= 0]))
    where = f"in {views:,} {'view' if views == 1 else 'views'}" if views else "of no view"
    modalities = ", ".join(affinity.modalities)
    pairs = affinity.pairs.shape[1]
    return f"{len(affinity):,} observations {where}, {pairs:,} pairs, {modalities}"


def clusters(association: Association) -> str:
    """How many clusters were found, or links where there are none."""
    if association.num_clusters is None:
        return f"{association.links.shape[1]:,} links"
    return f"{association.num_clusters:,} clusters"


def status(association: Association) -> list[str]:
    """What was reached, and what happened."""
    bound = "" if association.gap is None else f" (gap {association.gap:.2%})"
    return [f"objective {association.objective:.6g}{bound}", f"status: {association.status.value}"]


def result_table(result: Result) -> str:
    """How good, or how many clusters, in each modality alone and in all together."""
    metrics = result.metrics()
    if metrics is not None:
        gallery = ("bcubed_f1", "rank1", "map") if "map" in metrics["all"] else ()
        return metrics_table(metrics, ("precision", "recall", "f1", *gallery))
    rows = [*result.alone.items(), ("all", result.association)]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {clusters(association)}" for name, association in rows)


def metrics_table(metrics: Mapping[str, Any], columns: tuple[str, ...]) -> str:
    """Rows of metrics, the single modalities first, and the true number of clusters at the end."""
    rows = {**metrics.get("alone", {}), "all": metrics["all"]}
    shown = [name for name in columns if name in metrics["all"]]
    titles = [("F1" if name == "f1" else name.replace("_", " ")) for name in shown]
    width = max(len(name) for name in [*rows, "truth"])
    widths = [max(len(title), 9) for title in titles]
    lines = [
        " " * width
        + "".join(f"  {t:>{w}}" for t, w in zip(titles, widths, strict=True))
        + "  clusters"
    ]
    for name, row in rows.items():
        cells = "".join(f"  {row[c]:>{w}.3f}" for c, w in zip(shown, widths, strict=True))
        lines.append(f"{name:<{width}}{cells}  {row.get('clusters', '-'):>8}")
    if "objects" in metrics["all"]:
        blank = "".join(" " * (w + 2) for w in widths)
        lines.append(f"{'truth':<{width}}{blank}  {metrics['all']['objects']:>8}")
    return "\n".join(lines)


def listing(out: Path, written: list[str]) -> list[str]:
    """What was written, each picture on a line of its own."""
    pictures = [name for name in written if name.endswith((".png", ".mp4"))]
    others = [name for name in written if name not in pictures]
    return [
        f"written to {out}: {', '.join(others)}",
        *(f"{'video' if name.endswith('.mp4') else 'picture'}: {out / name}" for name in pictures),
    ]
