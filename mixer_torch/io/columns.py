"""The columns of CSV and parquet files, with errors that name the column and the row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float64, Int64
from pyarrow import csv, parquet

PARQUET = (".parquet", ".pq")


class Columns:
    """A table whose columns are asked for by name and by what they have to be.

    Text in which every cell is a number counts as numbers, and an empty cell (or NaN, NA, null)
    as missing. In messages rows count from 1, the header apart.

    Args:
        path: A ``.parquet`` file, or a CSV file with a header (``.tsv``: apart by tabs). A file
            of no bytes has no columns.

    Raises:
        ValueError: The file does not read as what its name says, or two columns have one name.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        table = _read(path)
        names = [name.strip() for name in table.column_names]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"{path}: column {name!r} appears {names.count(name)} times")
        self.rows = table.num_rows
        self.columns = dict(zip(names, map(_typed, table.columns), strict=True))

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def column(self, name: str) -> pa.Array:
        """A column as it is; ValueError lists those that there are."""
        if name not in self.columns:
            have = ", ".join(self.columns) or "none"
            raise ValueError(f"{self.path}: column {name!r} is missing; columns: {have}")
        return self.columns[name]

    def numbers(self, name: str) -> Float64[np.ndarray, " m"]:
        """A column of finite numbers, NaN where one is missing."""
        column = self.column(name)
        if _is_text(column.type):
            self.refuse(
                name,
                column.is_valid().to_numpy(zero_copy_only=False) & ~_reads_as_number(column),
                "a number",
            )
        if not _is_number(column.type):
            raise ValueError(f"{self.path}: column {name!r}: expected numbers, got {column.type}")
        numbers = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        self.refuse(name, np.isinf(numbers), "a finite number")
        return numbers

    def integers(self, name: str) -> Int64[np.ndarray, " m"]:
        """A column of whole numbers, none missing."""
        numbers = self.numbers(name)
        self.refuse(name, numbers % 1 != 0, "a whole number")
        return self.column(name).cast(pa.int64()).to_numpy()

    def codes(self, name: str, missing: int | None = None) -> Int64[np.ndarray, " m"]:
        """Whole numbers as they are, and text numbered from 0 in alphabetical order.

        Args:
            name: The column.
            missing: What stands for a missing cell; None if none may be missing.
        """
        column = self.column(name)
        if pa.types.is_floating(column.type):
            column = pc.if_else(pc.is_nan(column), pa.scalar(None, column.type), column)
        empty = column.is_null().to_numpy(zero_copy_only=False)
        if missing is None:
            self.refuse(name, empty, "a number or a name")
        codes = np.full(self.rows, -1 if missing is None else missing, dtype=np.int64)
        if _is_text(column.type):
            words = column.drop_null().to_numpy(zero_copy_only=False).astype(str)
            codes[~empty] = np.unique(words, return_inverse=True)[1]
        else:
            self.refuse(name, ~empty & (self.numbers(name) % 1 != 0), "a whole number")
            codes[~empty] = column.drop_null().cast(pa.int64()).to_numpy()
        return codes

    def measurement(self, name: str) -> np.ndarray | None:
        """A column of numbers (m,), or of lists of numbers (m, d); None if it is anything else.

        Text is something else only if no cell of it is a number: one that is not a number among
        others that are is an error.
        """
        column = self.column(name)
        if _is_list(column.type):
            return self.lists(name)
        mixed = _is_text(column.type) and _reads_as_number(column).any()
        return self.numbers(name) if mixed or _is_number(column.type) else None

    def lists(self, name: str) -> Float64[np.ndarray, "m d"]:
        """A column of lists of equal length, of finite numbers; a row of NaN if missing."""
        column = self.column(name)
        length = pc.list_value_length(column).to_numpy(zero_copy_only=False).astype(np.float64)
        known = length[~np.isnan(length)]
        width = int(known[0]) if len(known) else 0
        self.refuse(name, ~np.isnan(length) & (length != width), f"a list of {width}")
        values = np.full((self.rows, width), np.nan)
        flat = column.drop_null().flatten().cast(pa.float64()).to_numpy(zero_copy_only=False)
        values[~np.isnan(length)] = flat.reshape(-1, width)
        self.refuse(name, np.isinf(values).any(1), "finite numbers")
        return values

    def words(self, name: str) -> list[Any]:
        """The cells of a column as Python values, none missing; 3.0 among whole numbers is 3."""
        column = self.column(name)
        self.refuse(name, column.is_null().to_numpy(zero_copy_only=False), "a value")
        if pa.types.is_floating(column.type) and not (self.numbers(name) % 1).any():
            column = column.cast(pa.int64())
        return column.to_pylist()

    def refuse(self, name: str, wrong: Any, expected: str) -> None:
        """ValueError that names the column, the first row that is wrong and what is there."""
        if np.any(wrong):
            row = int(np.argmax(wrong))
            raise ValueError(
                f"{self.path}, row {row + 1}, column {name!r}: expected {expected}, "
                f"got {self.column(name)[row].as_py()!r}"
            )


def _read(path: Path) -> pa.Table:
    try:
        if path.suffix.lower() in PARQUET:
            return parquet.read_table(path)
        if not path.stat().st_size:
            return pa.table({})
        return csv.read_csv(
            path,
            # One thread, so that messages about malformed lines name the line.
            read_options=csv.ReadOptions(use_threads=False),
            parse_options=csv.ParseOptions(
                delimiter="\t" if path.suffix.lower() == ".tsv" else ",", newlines_in_values=True
            ),
            convert_options=csv.ConvertOptions(strings_can_be_null=True),
        )
    except pa.ArrowInvalid as error:
        raise ValueError(f"{path} is not readable as a table: {error}") from error


def _typed(chunks: pa.ChunkedArray) -> pa.Array:
    """Whole numbers as int64, others as float64, text trimmed, all else as it is."""
    column = chunks.combine_chunks()
    if pa.types.is_dictionary(column.type):
        column = column.dictionary_decode()
    if _is_text(column.type):
        column = pc.utf8_trim_whitespace(column)
        column = pc.if_else(pc.equal(column, ""), pa.scalar(None, column.type), column)
        targets = [pa.int64(), pa.float64()]
    elif pa.types.is_floating(column.type):
        targets = [pa.float64()]
    elif _is_whole(column.type):
        targets = [pa.int64()]
    else:
        targets = []
    for target in targets:
        try:
            return column.cast(target)
        except pa.ArrowInvalid:
            continue
    return column


def _is_text(kind: pa.DataType) -> bool:
    return pa.types.is_string(kind) or pa.types.is_large_string(kind)


def _is_whole(kind: pa.DataType) -> bool:
    return pa.types.is_integer(kind) or pa.types.is_boolean(kind) or pa.types.is_null(kind)


def _is_number(kind: pa.DataType) -> bool:
    return pa.types.is_integer(kind) or pa.types.is_floating(kind)


def _is_list(kind: pa.DataType) -> bool:
    return (
        pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
    )


def _reads_as_number(column: pa.Array) -> Bool[np.ndarray, " m"]:
    """Which cells of a column of text are numbers."""
    reads = np.zeros(len(column), dtype=bool)
    for i, word in enumerate(column.to_pylist()):
        try:
            reads[i] = word is not None and np.isfinite(float(word))
        except ValueError:
            continue
    return reads
