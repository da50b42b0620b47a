"""What there is to choose from: scorers, solvers, datasets and the rest, ours and others'."""

from __future__ import annotations

import inspect
import pkgutil
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from mixer_torch.datasets.base import Dataset
from mixer_torch.fusion import Fusion
from mixer_torch.pairs import PairSelector
from mixer_torch.scoring import Calibrator, Scorer
from mixer_torch.solvers.problem import Solver
from mixer_torch.tracking.base import BaseTracker


@dataclass(frozen=True)
class Kind:
    """One extension point.

    Args:
        name: What its members are called; ``mixer_torch.<name>`` is the group of entry points.
        base: The class that members extend.
        modules: Modules and packages that hold the project's own; packages are searched.
    """

    name: str
    base: type
    modules: tuple[str, ...]


# Named and not imported: mixer_torch imports no scorer.
KINDS = (
    Kind("scorers", Scorer, ("mixer_torch.scoring", "mixer_torch.scorers")),
    Kind("solvers", Solver, ("mixer_torch.solvers",)),
    Kind("datasets", Dataset, ("mixer_torch.datasets",)),
    Kind("calibrators", Calibrator, ("mixer_torch.scoring", "mixer_torch.scorers")),
    Kind("fusions", Fusion, ("mixer_torch.fusion",)),
    Kind("pairs", PairSelector, ("mixer_torch.pairs",)),
    Kind("trackers", BaseTracker, ("mixer_torch.tracking",)),
)


@dataclass(frozen=True)
class Member:
    """One thing to choose.

    Args:
        class_path: What to write in a configuration; the entry point's value where it is broken.
        summary: First paragraph of its docstring as plain text, or what went wrong.
        cls: The class; None where it could not be loaded.
    """

    class_path: str
    summary: str
    cls: type | None


def members(kind: Kind, announced: Iterable[EntryPoint] | None = None) -> list[Member]:
    """All members of a kind, by class path: the project's own and those that packages announce.

    What does not load is listed with its error.

    Args:
        kind: One of :data:`KINDS`.
        announced: Entry points; those of the group ``mixer_torch.<kind>`` that are installed if
            None.
    """
    if announced is None:
        announced = entry_points(group=f"mixer_torch.{kind.name}")
    found: dict[Any, Member] = {}
    for module in kind.modules:
        for member in _in_module(module, kind.base):
            found.setdefault(member.cls or member.class_path, member)
    for point in announced:
        member = _load(point, kind.base)
        found.setdefault(member.cls or member.class_path, member)
    return sorted(found.values(), key=lambda member: member.class_path)


def _in_module(name: str, base: type) -> Iterator[Member]:
    try:
        module = import_module(name)
    except Exception as error:
        yield _broken(name, error)
        return
    for cls in vars(module).values():
        if _is_member(cls, base) and cls.__module__ == name:
            yield Member(_shortest_path(cls), _summary(cls), cls)
    for child in pkgutil.iter_modules(getattr(module, "__path__", ())):
        yield from _in_module(f"{name}.{child.name}", base)


def _is_member(cls: Any, base: type) -> bool:
    return (
        inspect.isclass(cls)
        and issubclass(cls, base)
        and not inspect.isabstract(cls)
        and not cls.__name__.startswith("_")
        and not (cls is base and base is not Calibrator)
        and cls is not Fusion
    )


def _load(point: EntryPoint, base: type) -> Member:
    try:
        cls = point.load()
        if not _is_member(cls, base):
            raise TypeError(f"expected a concrete subclass of {base.__name__}, got {cls!r}")
    except Exception as error:
        return _broken(point.value.replace(":", "."), error)
    return Member(point.value.replace(":", "."), _summary(cls), cls)


def _broken(path: str, error: Exception) -> Member:
    return Member(path, f"does not load: {type(error).__name__}: {error}", None)


def _shortest_path(cls: type) -> str:
    """The outermost package that exports the class, and its name."""
    parts = cls.__module__.split(".")
    for length in range(1, len(parts) + 1):
        package = ".".join(parts[:length])
        if getattr(import_module(package), cls.__name__, None) is cls:
            return f"{package}.{cls.__name__}"
    return f"{cls.__module__}.{cls.__qualname__}"


def _summary(cls: type) -> str:
    first = " ".join((inspect.getdoc(cls) or "").split("\n\n")[0].split())
    return re.sub(r":\w+:`~?([^`]*)`", r"\1", first).replace("``", "")
