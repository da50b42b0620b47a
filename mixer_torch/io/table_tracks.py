"""Tracks as a table, one row a box: CSV or parquet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from mixer_torch.io.columns import PARQUET, Columns
from mixer_torch.io.files import atomic_write, check_file
from mixer_torch.io.text import repeated
from mixer_torch.tracks import Tracks, from_one

BOX = ("x1", "y1", "x2", "y2")
SUFFIXES = (".csv", ".tsv", *PARQUET)


def read_table(path: str | Path) -> Tracks:
    """Read columns ``frame``, ``identity``, ``x1``, ``y1``, ``x2``, ``y2``, and others.

    Where there is no ``identity`` there has to be ``label``, a cluster from 0, as in the table that
    ``mixer associate`` writes: identity = label + 1. ``confidence``, ``camera`` and ``observation``
    are read where they are there; all other columns are let by. Identities and cameras may be
    names. Rows without an identity (an empty cell, or a negative number) or without a box are left
    out. Where identities count from 0, all are raised by 1.

    Args:
        path: CSV with a header (``.tsv``: apart by tabs), or ``.parquet``.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is empty, a column is missing, a cell is not what it has to be, or an
            identity is twice in a frame of a camera; the message names the row, from 1.
    """
    path = Path(path)
    check_file(path)
    columns = Columns(path)
    if not columns.columns:
        raise ValueError(f"{path} is empty: expected a header with frame, identity, x1, y1, x2, y2")
    name = "label" if "label" in columns and "identity" not in columns else "identity"
    identity = columns.codes(name, missing=-1)
    box = np.stack([columns.numbers(side) for side in BOX], 1)
    keep = (identity >= 0) & ~np.isnan(box).any(1)
    frame = columns.integers("frame")
    others = {
        "confidence": columns.numbers("confidence") if "confidence" in columns else None,
        "camera": columns.codes("camera") if "camera" in columns else None,
        "observation": columns.integers("observation") if "observation" in columns else None,
    }
    camera = np.zeros(columns.rows) if others["camera"] is None else others["camera"]
    again = np.zeros(columns.rows, dtype=bool)
    again[keep] = repeated(np.stack([frame, camera, identity], 1)[keep])
    columns.refuse(name, again, "an identity once in a frame of a camera")
    kept = {key: None if value is None else value[keep] for key, value in others.items()}
    identity = identity[keep] + 1 if name == "label" else from_one(identity[keep])
    return Tracks(frame[keep], identity, box[keep], **kept)


def write_table(path: str | Path, tracks: Tracks) -> None:
    """Write columns frame, identity, x1, y1, x2, y2, confidence, camera and observation.

    A confidence that is not known is an empty cell.

    Args:
        path: ``.csv``, ``.tsv`` or ``.parquet``.
        tracks: The tracks.

    Raises:
        ValueError: The file name ends in none of these.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"path: expected a file name in {', '.join(SUFFIXES)}, got {path}")
    table = pa.table(
        {
            "frame": tracks.frame,
            "identity": tracks.identity,
            **dict(zip(BOX, tracks.box.T.copy(), strict=True)),
            "confidence": pa.array(tracks.confidence, from_pandas=True),
            "camera": tracks.camera,
            "observation": tracks.observation,
        }
    )
    with atomic_write(path) as partial:
        if suffix in PARQUET:
            parquet.write_table(table, partial)
        else:
            _write_text(partial, table, "\t" if suffix == ".tsv" else ",")


def _write_text(path: Path, table: pa.Table, delimiter: str) -> None:
    """Numbers under a header without quotation marks, which pyarrow would put around names."""
    options = csv.WriteOptions(include_header=False, delimiter=delimiter, quoting_style="none")
    with path.open("wb") as file:
        file.write((delimiter.join(table.column_names) + "\n").encode())
        csv.write_csv(table, file, options)
