"""What a result is written to: tables, metrics, and a folder replaced whole or not at all."""

from __future__ import annotations

import csv
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from mixer_torch.affinity import Affinity
from mixer_torch.association import Association
from mixer_torch.fusion import Fusion
from mixer_torch.io.files import check_folder, write_json
from mixer_torch.io.mot_tracks import write_mot
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.metrics.retrieval import retrieval_of_affinity
from mixer_torch.observations import Observations
from mixer_torch.tracks import Tracks

COLUMNS = ("observation", "view", "frame", "x1", "y1", "x2", "y2", "label")
FILES = (
    "associations.csv",
    "links.csv",
    "tracks.txt",
    "tracks_camera*.txt",
    "affinity.npz",
    "metrics.json",
    "config.yaml",
    "affinity.png",
    "clusters.png",
    "frames.png",
    "tracks.mp4",
)
"""All that a result may consist of, as patterns of names; what an earlier result left of them is
replaced or removed."""


@dataclass(frozen=True)
class Result:
    """One association, with what it was made from.

    Args:
        observations: What was seen.
        affinity: How alike.
        association: Who is who, by all modalities together.
        alone: The association that each modality makes alone; empty where that was not asked for.
        fusion: How the modalities were added up; the paper's ``LinearFusion()`` if None.
    """

    observations: Observations
    affinity: Affinity
    association: Association
    alone: Mapping[str, Association] = field(default_factory=dict)
    fusion: Fusion | None = None

    @property
    def identity(self) -> Tensor | None:
        """(m,) the truth; None where it is not known."""
        return known_identity(self.observations)

    def metrics(self) -> dict[str, Any] | None:
        """``{"all": {...}, "alone": {modality: {...}}}``, "alone" only where there is any.

        Each is what :func:`~mixer_torch.metrics.clustering.evaluate` finds; a gallery of several
        cameras has the figures of :mod:`~mixer_torch.metrics.retrieval` beside them. None where
        identities are not known.
        """
        identity, view = self.identity, self.observations.view
        if identity is None:
            return None

        def measured(association: Association, affinity: Affinity, fusion: Fusion | None) -> Any:
            ranked = retrieval_of_affinity(affinity, self.observations, fusion)
            return evaluate(association, identity, view) | (ranked or {})

        metrics = {"all": measured(self.association, self.affinity, self.fusion)}
        if self.alone:
            metrics["alone"] = {
                name: measured(association, self.affinity.select(name), None)
                for name, association in self.alone.items()
            }
        return metrics


def known_identity(observations: Observations) -> Tensor | None:
    """The feature ``identity``, unless it is missing or -1 throughout."""
    identity = observations.features.get("identity")
    if identity is None or (len(identity) and bool((identity < 0).all())):
        return None
    return identity


def write_tables(folder: Path, result: Result) -> None:
    """Write the files that are no pictures.

    They are associations.csv, tracks.txt (where there are boxes, frames and labels; one for each
    camera where there are several), links.csv (where there are no labels), affinity.npz and
    metrics.json (where identities are known).
    """
    write_associations(folder / "associations.csv", result.observations, result.association.labels)
    if result.association.labels is None:
        write_links(folder / "links.csv", result.association.links)
    elif {"box", "frame"} <= set(result.observations.features):
        write_tracks(folder / "tracks.txt", result.observations, result.association.labels)
    result.affinity.save(folder / "affinity.npz")
    metrics = result.metrics()
    if metrics is not None:
        write_json(folder / "metrics.json", metrics)


def write_associations(path: Path, observations: Observations, labels: Tensor | None) -> None:
    """One row an observation: :data:`COLUMNS`. A cell is empty where a value is not known."""
    m = len(observations)
    boxes = _rows(observations.features.get("box"), m)
    frames = _column(observations.features.get("frame"), m)
    columns = zip(
        range(m), observations.view.tolist(), frames, boxes, _column(labels, m), strict=True
    )
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for i, view, frame, box, label in columns:
            writer.writerow([i, view, frame, *box, label])


def write_tracks(path: Path, observations: Observations, labels: Tensor) -> None:
    """The MOTChallenge result format, one file for each camera where there are several.

    Identifiers count from 1. Observations without a box are left out. The format cannot tell
    cameras apart, so the file name does, as in tracks_camera2.txt. Nothing is written where a
    label has two boxes in one frame of a camera, which it may have where views are not frames:
    these are no tracks.
    """
    frame = observations["frame"]
    seen = observations["box"].isfinite().all(1)
    place = torch.stack([frame, observations.camera, labels.to(frame)], 1)[seen]
    if len(place.unique(dim=0)) < len(place):
        return
    tracks = Tracks.from_labels(observations, labels)
    cameras = np.unique(tracks.camera)
    if len(cameras) < 2:
        write_mot(path, tracks)
        return
    for number in cameras:
        name = f"{path.stem}_camera{number}{path.suffix}"
        write_mot(path.with_name(name), tracks.select(tracks.camera == number))


def write_links(path: Path, links: Tensor) -> None:
    """One row for each pair that is declared the same: first, second."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("first", "second"))
        writer.writerows(links.T.tolist())


def read_labels(path: Path) -> dict[str, Tensor]:
    """The integer columns of an association's table.

    Args:
        path: CSV with a header and at least the column ``label``.

    Returns:
        ``label``, and of ``observation``, ``view`` and ``identity`` those that there are, each
        (m,) int64.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A column is missing, or a cell is not an integer; the message names the line.
    """
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        names = [
            name
            for name in ("observation", "view", "identity", "label")
            if name in (reader.fieldnames or ())
        ]
        if "label" not in names:
            have = ", ".join(reader.fieldnames or ()) or "none"
            raise ValueError(f"{path}: expected a column 'label'; columns: {have}")
        values: dict[str, list[int]] = {name: [] for name in names}
        for row in reader:
            for name in names:
                values[name].append(_integer(row[name], name, path, reader.line_num))
    return {name: torch.tensor(column, dtype=torch.int64) for name, column in values.items()}


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A new folder to write a result to, moved to its place when all is written.

    Where writing fails, the place stays as it was. Where it succeeds, it holds the new result and,
    of :data:`FILES`, no others; files of other names are left alone.

    Args:
        folder: The place; made, with its parents, where it does not exist.

    Raises:
        NotADirectoryError: There is a file in its place.
    """
    folder = folder.resolve()
    check_folder(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    stage = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield stage
        folder.mkdir(exist_ok=True)
        for old in [path for pattern in FILES for path in folder.glob(pattern)]:
            if not (stage / old.name).exists():
                old.unlink()
        for path in sorted(stage.iterdir()):
            path.replace(folder / path.name)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def _integer(cell: str | None, name: str, path: Path, line: int) -> int:
    try:
        return int(cell or "")
    except ValueError:
        raise ValueError(
            f"{path}, line {line}: expected an integer in column {name!r}, got {cell!r}"
        ) from None


def _column(values: Tensor | None, m: int) -> list[Any]:
    return [""] * m if values is None else values.tolist()


def _rows(boxes: Tensor | None, m: int) -> list[list[str]]:
    if boxes is None:
        return [[""] * 4] * m
    return [
        [f"{value:.3f}" if np.isfinite(value) else "" for value in box] for box in boxes.tolist()
    ]
