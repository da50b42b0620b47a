"""The classes that a configuration may name: scorers, solvers, datasets and so on.

Those of this project are found in its modules, those of other packages by their entry points.
"""

from __future__ import annotations

import inspect
import pkgutil
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
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
    """One extension point: the subclasses of one base class.

    Args:
        name: Its plural, such as ``scorers``; ``mixer_torch.<name>`` is the group of entry points.
        base: The class that members extend.
        modules: Modules and packages that hold the project's own members; packages are searched.
    """

    name: str
    base: type
    modules: tuple[str, ...]


# Modules are named here and imported when they are asked for, as mixer_torch imports no scorer.
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
    """One class that a configuration may name.

    Args:
        class_path: Its shortest import path; the entry point's value where it does not load.
        summary: First paragraph of its docstring as plain text, or the error with which it fails.
        cls: The class; None where it does not load.
    """

    @property
    def name(self) -> str:
        """The bare class name, which will do in a configuration, too."""
        return self.class_path.rsplit(".", 1)[-1]

    class_path: str
    summary: str
    cls: type | None


def members(kind: Kind, announced: Iterable[EntryPoint] | None = None) -> list[Member]:
    """All members of a kind in the order of their class paths.

    These are the project's own and those that installed packages announce by entry points. A module
    or an entry point that does not load is listed with its error.

    Args:
        kind: One of :data:`KINDS`.
        announced: Entry points; if None, the installed ones of the group ``mixer_torch.<kind>``.
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


def everything() -> dict[str, list[Member]]:
    """The members of all kinds, by kind.

    As this imports them, jsonargparse then resolves their bare class names.
    """
    installed = entry_points()
    return {
        kind.name: members(kind, list(installed.select(group=f"mixer_torch.{kind.name}")))
        for kind in KINDS
    }


def near(name: str) -> str:
    """What to say of a name in a configuration that is no class which may stand there."""
    bare = name.rsplit(".", 1)[-1]
    listed = [(kind, member) for kind, found in everything().items() for member in found]
    same = [(kind, member) for kind, member in listed if member.name == bare]
    if broken := [member for _, member in same if member.cls is None]:
        return f"{name!r} {broken[0].summary}"
    says = f"{name!r} is not the name of a class that may stand here"
    if same:
        says += f"; {same[0][1].class_path} is one of the {same[0][0]}"
    lowered = {member.name.lower(): member.name for _, member in listed}
    alike = [lowered[word] for word in get_close_matches(bare.lower(), list(lowered))]
    if alike and not same:
        says += f"; did you mean {' or '.join(alike)}?"
    return f"{says} (`mixer list` shows all; your own need their module: module.Class)"


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
