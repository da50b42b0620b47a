"""`mixer bench`: run one of the modules in the folder `benchmarks`."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from pathlib import Path


def bench(name: str, out: Path | None = None, quick: bool = False, from_rows: bool = False) -> str:
    """Run a benchmark: rows first, then tables and figures, which are made from the rows alone.

    Args:
        name: A module of the folder `benchmarks`, such as table2.
        out: Folder to write to; out/benchmarks/NAME if null.
        quick: Make a small run, to see that it works.
        from_rows: Run nothing; make tables and figures from the rows of an earlier run.
    """
    package = import_module("mixer_torch.benchmarks")
    found = sorted(module.name for module in pkgutil.iter_modules(package.__path__))
    module = import_module(f"{package.__name__}.{name}") if name in found else None
    run = getattr(module, "main", None)
    if run is None:
        raise ValueError(f"name: expected a benchmark, one of {', '.join(found)}, got {name!r}")
    folder = out or Path("out", "benchmarks", name)
    switches = {"--quick": quick, "--from_rows": from_rows}
    options = [option for option, given in switches.items() if given]
    text = run(["--out", str(folder), *options])
    return f"{text or ''}\nwritten to {folder}".lstrip()
