"""What all benchmarks share: arguments, rows in a file, and what tables are made of."""

import argparse
import csv
import statistics
from collections import defaultdict
from pathlib import Path

import torch


def arguments(module, argv, quick, **values):
    """Arguments of a benchmark: --out, --quick, --from_rows, and values with a default.

    Args:
        module: Its file, which names its folder, and its docstring.
        argv: What was given; that of the process if None.
        quick: What --quick does.
        values: (default, help) by name, of the type of the default.
    """
    path, text = module
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawTextHelpFormatter
    )
    folder = Path("out", "benchmarks", Path(path).stem)
    parser.add_argument("--out", type=Path, default=folder)
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--from_rows", action="store_true", help="only make tables and figures")
    for name, (default, help_) in values.items():
        parser.add_argument(f"--{name}", type=type(default), default=default, help=help_)
    return parser.parse_args(argv)


def machine():
    """What the timings were taken on, in a line."""
    return f"CPU, {torch.get_num_threads()} threads, torch {torch.__version__}"


def write(path, columns, rows):
    """Rows as CSV, the folder made if it is not there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def read(path):
    """Rows of a CSV, numbers as numbers."""
    with path.open(newline="") as file:
        return [{key: number(value) for key, value in row.items()} for row in csv.DictReader(file)]


def tabled(out, table):
    """Write table.md, made from nothing but the rows.csv in a folder; the text comes back."""
    return write_table(out, table(read(out / "rows.csv")))


def means(head, groups, columns, key, digits):
    """A Markdown table of the mean of a column: one row a group, one cell for each of its columns.

    Args:
        head: Of the first column.
        groups: Rows by name of the row, then by name of the column.
        columns: Names of the columns.
        key: What is averaged.
        digits: After the decimal point.
    """
    lines = [f"| {head} | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for name, group in groups.items():
        cells = [f"{mean(group[column], key):.{digits}f}" for column in columns]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def write_table(out, text):
    """Write table.md to a folder; the text comes back."""
    (out / "table.md").write_text(text)
    return text


def number(text):
    try:
        return float(text)
    except ValueError:
        return text


def grouped(rows, *keys):
    """Lists of rows by the values of some columns, in the order of first appearance."""
    groups = defaultdict(list)
    for row in rows:
        groups[tuple(row[key] for key in keys)].append(row)
    return groups


def mean(rows, key):
    return statistics.fmean(row[key] for row in rows)


def spread(rows, key):
    """Standard deviation over the rows, 0 for one."""
    return statistics.stdev(row[key] for row in rows) if len(rows) > 1 else 0.0
