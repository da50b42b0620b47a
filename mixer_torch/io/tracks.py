"""Tracks in files: the format is told by the ending of the name.

========================= ============================= ==================================
``.txt``                  :func:`read_mot`              :func:`write_mot`
``.json``                 :func:`read_coco`             :func:`write_coco`
``.csv``, ``.parquet``    :func:`read_table`            :func:`write_table`
========================= ============================= ==================================

:mod:`mixer_torch.tracking.supervision` has them in the hands of the package supervision.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mixer_torch.io.coco import read_coco, write_coco
from mixer_torch.io.mot_tracks import MotTruth, read_mot, read_mot_truth, write_mot
from mixer_torch.io.table_tracks import SUFFIXES as TABLES
from mixer_torch.io.table_tracks import read_table, write_table
from mixer_torch.tracks import Tracks

__all__ = [
    "MotTruth",
    "read_coco",
    "read_mot",
    "read_mot_truth",
    "read_table",
    "read_tracks",
    "write_coco",
    "write_mot",
    "write_table",
    "write_tracks",
]

READERS: dict[str, Callable[[str | Path], Tracks]] = {
    ".txt": read_mot,
    ".json": read_coco,
    **dict.fromkeys(TABLES, read_table),
}
WRITERS: dict[str, Callable[[str | Path, Tracks], None]] = {
    ".txt": write_mot,
    ".json": write_coco,
    **dict.fromkeys(TABLES, write_table),
}


def read_tracks(path: str | Path) -> Tracks:
    """Read tracks in the format that the file name ends in.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is malformed, or its name ends in no known format.
    """
    return READERS[_suffix(path)](path)


def write_tracks(path: str | Path, tracks: Tracks) -> None:
    """Write tracks in the format that the file name ends in, whole or not at all.

    Raises:
        ValueError: The name ends in no known format, or the format cannot hold the tracks.
    """
    WRITERS[_suffix(path)](path, tracks)


def _suffix(path: str | Path) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in READERS:
        raise ValueError(f"path: expected a file name in {', '.join(READERS)}, got {path}")
    return suffix
