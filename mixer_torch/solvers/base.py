"""solve(): an affinity in, an association whose constraints have been checked out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, overload

import torch
from jaxtyping import Int64
from torch import Tensor

from mixer_torch.affinity import Affinity
from mixer_torch.association import Association, Status, by_first_appearance
from mixer_torch.fusion import Fusion
from mixer_torch.observations import distinct_views
from mixer_torch.solvers.bounds import lower_bound
from mixer_torch.solvers.constraints import Reduction, constrain
from mixer_torch.solvers.mixer import Mixer
from mixer_torch.solvers.problem import (
    Problem,
    Solution,
    Solver,
    cost_inside,
    cost_of_links,
    is_distinct,
    objective_of,
    problem_of,
)
from mixer_torch.solvers.transfer import on_devices, on_host, through_host

__all__ = ["Problem", "Solution", "Solver", "is_distinct", "objective_of", "problem_of", "solve"]


@overload
def solve(
    affinity: Affinity,
    solver: Solver | None = None,
    fusion: Fusion | None = None,
    *,
    must_link: Any = None,
    cannot_link: Any = None,
    indistinct: Any = None,
    bound: bool = False,
) -> Association: ...
@overload
def solve(
    affinity: Sequence[Affinity],
    solver: Solver | None = None,
    fusion: Fusion | None = None,
    *,
    must_link: Any = None,
    cannot_link: Any = None,
    indistinct: Any = None,
    bound: bool = False,
) -> list[Association]: ...
def solve(
    affinity: Affinity | Sequence[Affinity],
    solver: Solver | None = None,
    fusion: Fusion | None = None,
    *,
    must_link: Any = None,
    cannot_link: Any = None,
    indistinct: Any = None,
    bound: bool = False,
) -> Association | list[Association]:
    """The clusters that agree best with the scores.

    Args:
        affinity: Scores of pairs, or a list of affinities, which are solved together.
        solver: The algorithm; ``Mixer()`` if None.
        fusion: How modalities add up; the paper's ``LinearFusion()`` if None.
        must_link: (2, K) pairs of observations that are the same. Their cost counts.
        cannot_link: (2, K) pairs of observations that are not the same.
        indistinct: Views in which distinctness does not hold (a gallery of single images): their
            observations are treated as if they had no view. Pairs within such a view are listed
            only where the affinity gave them no view, see ``Affinity.from_dense(indistinct=)``.
        bound: Prove a lower bound of the objective, so that the association's ``gap`` is a fact,
            whatever the solver (see ``solvers/bounds.py``).

    For a list of affinities, each constraint is None or a list with an entry for each of them.

    Returns:
        An association (a list of them for a list): cycle consistent, one-to-one and distinct within
        each view, unless its status is ``INCONSISTENT``.

    Raises:
        RuntimeError: The solver's result breaks a constraint. This is a fault of the solver.
        TypeError: An argument is of the wrong type.
        ValueError: The constraints contradict one another, or the solver cannot honour them.
    """
    solver = Mixer() if solver is None else solver
    if not isinstance(solver, Solver):
        raise TypeError(f"solver: expected an instance of Solver, got {solver!r}")
    single = isinstance(affinity, Affinity)
    affinities = [affinity] if isinstance(affinity, Affinity) else list(affinity)
    for item in affinities:
        if not isinstance(item, Affinity):
            raise TypeError(f"affinity: expected Affinity or a list of them, got {item!r}")
    start = time.perf_counter()
    links = {"must_link": must_link, "cannot_link": cannot_link, "indistinct": indistinct}
    wanted = _each(links, None if single else len(affinities))
    problems = _problems(affinities, fusion)
    posed = [
        constrain(problem, item.view, **each)
        for problem, item, each in zip(problems, affinities, wanted, strict=True)
    ]
    solutions = list(_run(solver, [reduction.problem for _, reduction in posed], single, bound))
    answers = _associations(posed, solutions)
    seconds = (time.perf_counter() - start) / max(len(answers), 1)
    for answer in answers:
        answer.stats.setdefault("seconds", seconds)  # type: ignore[attr-defined]
    return answers[0] if single else answers


def _each(links: Mapping[str, Any], count: int | None) -> list[dict[str, Any]]:
    """The constraints of each problem; count is None where a single affinity came."""
    if count is None:
        return [dict(links)]
    for name, value in links.items():
        if value is not None and not (isinstance(value, list | tuple) and len(value) == count):
            raise ValueError(
                f"{name}: expected None or a list with an entry for each of {count} affinities, "
                f"got {value!r}"
            )
    return [
        {name: None if value is None else value[i] for name, value in links.items()}
        for i in range(count)
    ]


def _run(
    solver: Solver, problems: Sequence[Problem], single: bool, bound: bool
) -> Iterator[Solution]:
    """The solution of each problem, those that have no nodes included."""
    full = [problem for problem in problems if len(problem)]
    for problem in full:
        if problem.groups is not None and not solver.takes_groups:
            raise ValueError(
                f"solver: {type(solver).__name__} cannot honour these must_link or cannot_link "
                "pairs, which give some observations more than one view; use Mixer or Exact"
            )
    solved = iter(solver.run_batch(full) if not single else [solver.run(p) for p in full])
    for problem in problems:
        if not len(problem):
            empty = torch.zeros(0, dtype=torch.int64, device=problem.view.device)
            yield Solution(Status.OPTIMAL, labels=empty, lower_bound=0.0)
            continue
        solution = next(solved)
        if bound and solution.lower_bound is None:
            solution = replace(solution, lower_bound=lower_bound(problem))
        yield solution


def _problems(affinities: Sequence[Affinity], fusion: Fusion | None) -> list[Problem]:
    """The problem of each affinity; however many there are, the host waits for a device once."""
    views = through_host(distinct_views, [affinity.view for affinity in affinities])
    return [
        problem_of(affinity, fusion, view) for affinity, view in zip(affinities, views, strict=True)
    ]


def _associations(
    posed: Sequence[tuple[Problem, Reduction]], solutions: Sequence[Solution]
) -> list[Association]:
    """The checked answers to problems, from solutions of their reductions.

    Without constraints, the host waits for a device as often for many problems as for one.
    """
    solutions = _expanded([reduction for _, reduction in posed], solutions)
    labels = _renumbered([problem for problem, _ in posed], solutions)
    objectives = []
    for i, ((problem, reduction), solution) in enumerate(zip(posed, solutions, strict=True)):
        if i in labels:
            if broken := reduction.broken(labels[i]):
                raise RuntimeError(f"the solver broke {broken}")
            objectives.append(cost_inside(problem, labels[i]))
        elif solution.links is not None:
            objectives.append(cost_of_links(problem, solution.links))
        else:
            raise RuntimeError("the solver returned neither labels nor links")
    answers = []
    for i, (solution, objective) in enumerate(zip(solutions, on_host(objectives), strict=True)):
        links = None if i in labels else solution.links
        reached = float(objective), solution.status, solution.lower_bound, dict(solution.stats)
        answers.append(Association(labels.get(i), *reached, links))
    return answers


def _expanded(reductions: Sequence[Reduction], solutions: Sequence[Solution]) -> list[Solution]:
    """Solutions of reduced problems, with labels for all observations, where the problems are."""
    given = {i: s.labels for i, s in enumerate(solutions) if s.labels is not None}
    for i, label in given.items():
        if len(label) != len(reductions[i].problem):
            raise RuntimeError(
                f"the solver returned {len(label)} labels for {len(reductions[i].problem)}"
            )
    devices = [reductions[i].node.device for i in given]
    there = dict(zip(given, on_devices(list(given.values()), devices), strict=True))
    return [
        reduction.expand(replace(solution, labels=there.get(i)))
        for i, (reduction, solution) in enumerate(zip(reductions, solutions, strict=True))
    ]


def _renumbered(
    problems: Sequence[Problem], solutions: Sequence[Solution]
) -> dict[int, Int64[Tensor, " m"]]:
    """By problem, labels in order of first appearance, where there are any and views stay apart."""
    given = {i: s.labels for i, s in enumerate(solutions) if s.labels is not None}
    views = [problems[i].view for i in given]
    host = on_host([*given.values(), *views])
    labels = [by_first_appearance(label) for label in host[: len(given)]]
    for label, view in zip(labels, host[len(given) :], strict=True):
        if not is_distinct(label, view):
            raise RuntimeError("the solver put two observations of one view into one cluster")
    there = on_devices(labels, [view.device for view in views])
    return dict(zip(given, there, strict=True))
