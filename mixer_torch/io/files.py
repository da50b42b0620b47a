"""Finding, reading and writing files, whatever is in them; what is written appears whole or not."""

from __future__ import annotations

import gzip
import json
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


def find(path: str | Path) -> Path:
    """A path as it stands, or, if relative and not there, inside the folder ``$MIXER_DATA``.

    Raises:
        FileNotFoundError: It is in neither place.
    """
    path = Path(path).expanduser()
    root = os.environ.get("MIXER_DATA")
    places = [path] if root is None or path.is_absolute() else [path, Path(root) / path]
    for place in places:
        if place.exists():
            return place
    hint = "" if root or path.is_absolute() else " (and MIXER_DATA, where else to look, is not set)"
    raise FileNotFoundError(f"{' and '.join(map(str, places))}: not found{hint}")


def check_file(path: Path, what: str = "") -> None:
    """Check that a file is there. ``what`` opens the message: what the file is for.

    Raises:
        FileNotFoundError: There is no such file.
        IsADirectoryError: It is a folder.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{what}{path} is a folder, expected a file")
    if not path.is_file():
        raise FileNotFoundError(f"{what}{path} does not exist")


def check_folder(folder: Path) -> None:
    """NotADirectoryError where a file stands in the place of a folder."""
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"out: expected a folder, got the file {folder}")


def read_text(path: Path) -> str:
    """The text of a file, unpacked where its name ends in ``.gz``.

    Raises:
        OSError: There is no such file, or it is a folder.
        ValueError: It does not unpack, or is not text.
    """
    check_file(path)
    opener: Any = gzip.open if path.suffix == ".gz" else open
    try:
        with opener(path, "rt", encoding="utf-8-sig") as file:
            return file.read()
    except (UnicodeDecodeError, gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{path} is not readable as text: {error}") from error


def read_json(path: Path) -> Any:
    """The content of a JSON file, packed (``.gz``) or not.

    Raises:
        OSError: There is no such file, or it is a folder.
        ValueError: It is not JSON; the message names the file and the line.
    """
    try:
        return json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{path}, line {error.lineno}: not readable as JSON: {error.msg}"
        ) from error


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """A temporary file to write to, beside path, which takes its place when all is written.

    Where writing fails, or is interrupted, what was at path stays as it was. The temporary file's
    name has the same ending, as some writers go by it.
    """
    path = Path(path)
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_json(path: str | Path, value: Mapping[str, Any], **options: Any) -> None:
    """Write JSON, indented for people to read, too; options are those of :func:`json.dumps`."""
    text = json.dumps(value, **{"indent": 2, **options})
    with atomic_write(path) as partial:
        partial.write_text(text + "\n", encoding="utf-8")


def save_npz(path: str | Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays to an npz file."""
    with atomic_write(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_npz(path: str | Path, kind: str) -> dict[str, np.ndarray]:
    """Read an npz that says it is of a kind, never unpickling.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is not an npz, or of another kind.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{path} is not a readable npz file: {error}") from error
    found = str(arrays.pop("format", "of no known kind"))
    if found != kind:
        raise ValueError(f"{path}: expected a file of kind {kind!r}, got {found!r}")
    return arrays
