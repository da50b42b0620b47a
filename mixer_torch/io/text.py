"""Tables of numbers in text files, with errors that name the line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from mixer_torch.io.files import read_text

GUESS = "guess"
"""Commas, or white space where the first line that is not blank has no comma."""


def read_numbers(
    path: Path, columns: int, delimiter: str | None = None, label: str | None = None
) -> tuple[Float64[np.ndarray, "n columns"], Int64[np.ndarray, " n"]]:
    """Read a table of numbers; blank lines do not count.

    Args:
        path: Text file, packed if its name ends in ``.gz``.
        columns: How many columns there have to be at least.
        delimiter: What stands between numbers; white space if None, and :data:`GUESS` to look.
        label: What opens text at the end of a line, which is left out; None if there is no text.

    Returns:
        The numbers, and the line of the file that each row stands on, from 1. An empty file has
        no rows, of ``columns`` columns.

    Raises:
        OSError: There is no such file, or it is a folder.
        ValueError: A line is malformed; the message names the file and the line.
    """
    lines = read_text(path).split("\n")
    if label is not None:
        lines = [line.partition(label)[0] for line in lines]
    number = np.array([i for i, line in enumerate(lines, 1) if line.strip()], dtype=np.int64)
    if not len(number):
        return np.empty((0, columns)), number
    if delimiter == GUESS:
        delimiter = "," if "," in lines[number[0] - 1] else None
    try:
        text = (lines[i - 1] for i in number)
        rows = np.loadtxt(text, delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        raise ValueError(_explain(path, lines, number, delimiter)) from None
    if rows.shape[1] < columns:
        raise ValueError(
            f"{path}, line {number[0]}: expected at least {columns} numbers, got {rows.shape[1]}"
        )
    return rows, number


def refuse(path: Path, number: Int64[np.ndarray, " n"], wrong: Any, message: str) -> None:
    """ValueError that names the file and the first line that is wrong, if any is."""
    wrong = np.asarray(wrong)
    if wrong.any():
        raise ValueError(f"{path}, line {number[wrong.argmax()]}: {message}")


def repeated(rows: Any) -> Bool[np.ndarray, " n"]:
    """Which rows (n, d) are equal to a row before them."""
    again = np.ones(len(rows), dtype=bool)
    again[np.unique(rows, axis=0, return_index=True)[1]] = False
    return again


def _explain(path: Path, lines: list[str], number: np.ndarray, delimiter: str | None) -> str:
    """Why a table that did not read did not: its first line that is malformed."""
    expected = len(lines[number[0] - 1].split(delimiter))
    for i in number:
        words = lines[i - 1].split(delimiter)
        for word in words:
            try:
                float(word)
            except ValueError:
                return f"{path}, line {i}: expected a number, got {word.strip()!r}"
        if len(words) != expected:
            return f"{path}, line {i}: expected {expected} numbers, got {len(words)}"
    return f"{path}: not readable as a table of numbers"
