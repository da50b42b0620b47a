"""What a solver is, and solve(): an affinity in, an association that is checked out."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.affinity import Affinity
from mixer_torch.association import Association, Status, by_first_appearance
from mixer_torch.fusion import Fusion
from mixer_torch.observations import distinct_views


@dataclass(frozen=True)
class Problem:
    """What a solver is given: correlation clustering with cannot-link inside each view.

        minimise  sum of cost over the pairs inside clusters
        subject to  at most one observation of each view in a cluster

    Args:
        pairs: (2, P) int64, smaller index first, none within a view.
        cost: (P,) float: negative attracts, positive repels; a pair not listed costs 0.
        view: (m,) int64 >= 0.
        score: (P,) the mean of the modalities' scores, for algorithms that know only one score
            a pair. It is 0.5 where the paper's cost is 0: mean = (1 - cost / l) / 2.
    """

    pairs: Int64[Tensor, "2 P"]
    cost: Float[Tensor, " P"]
    view: Int64[Tensor, " m"]
    score: Float[Tensor, " P"]

    def __len__(self) -> int:
        """m, the number of observations."""
        return len(self.view)

    def dense_cost(self) -> Float[Tensor, "m m"]:
        """The symmetric matrix Ā of fused costs, 0 on the diagonal and within views."""
        full = self.cost.new_zeros(len(self), len(self))
        full[self.pairs[0], self.pairs[1]] = self.cost
        full[self.pairs[1], self.pairs[0]] = self.cost
        return full


@dataclass(frozen=True)
class Solution:
    """What a solver returns: labels (m,) of any integers, or, if it has none, links (2, Q)."""

    status: Status
    labels: Tensor | None = None
    links: Tensor | None = None
    lower_bound: float | None = None
    stats: Mapping[str, Any] = field(default_factory=dict)


class Solver(ABC):
    """An algorithm. Its constructor takes the knobs; :func:`solve` does the rest."""

    @abstractmethod
    def run(self, problem: Problem) -> Solution:
        """Solve one problem with m >= 1, on the device of its tensors, writing to none of them."""

    def run_batch(self, problems: Sequence[Problem]) -> list[Solution]:
        """Solve several; one after the other unless a solver knows better."""
        return [self.run(problem) for problem in problems]


@overload
def solve(
    affinity: Affinity, solver: Solver | None = None, fusion: Fusion | None = None
) -> Association: ...
@overload
def solve(
    affinity: Sequence[Affinity], solver: Solver | None = None, fusion: Fusion | None = None
) -> list[Association]: ...
def solve(
    affinity: Affinity | Sequence[Affinity],
    solver: Solver | None = None,
    fusion: Fusion | None = None,
) -> Association | list[Association]:
    """The clusters that agree best with the scores.

    Args:
        affinity: Scores of pairs, or a list of affinities, which are solved together.
        solver: The algorithm; ``Mixer()`` if None.
        fusion: How modalities add up; the paper's ``LinearFusion()`` if None.

    Returns:
        An association (a list of them for a list): cycle consistent, one-to-one and distinct within
        each view, unless its status is ``INCONSISTENT``.

    Raises:
        RuntimeError: The solver's result breaks a constraint. This is a fault of the solver.
        TypeError: An argument is of the wrong type.
    """
    from mixer_torch.solvers.mixer import Mixer

    solver = Mixer() if solver is None else solver
    if not isinstance(solver, Solver):
        raise TypeError(f"solver: expected an instance of Solver, got {solver!r}")
    single = isinstance(affinity, Affinity)
    affinities = [affinity] if single else list(affinity)
    for item in affinities:
        if not isinstance(item, Affinity):
            raise TypeError(f"affinity: expected Affinity or a list of them, got {item!r}")
    start = time.perf_counter()
    problems = [problem_of(item, fusion) for item in affinities]
    full = [problem for problem in problems if len(problem)]
    solutions = iter(solver.run_batch(full) if not single else [solver.run(p) for p in full])
    empty = Solution(Status.OPTIMAL, labels=torch.zeros(0, dtype=torch.int64))
    answers = [
        _association(problem, next(solutions) if len(problem) else empty) for problem in problems
    ]
    seconds = (time.perf_counter() - start) / max(len(answers), 1)
    for answer in answers:
        answer.stats.setdefault("seconds", seconds)  # type: ignore[attr-defined]
    return answers[0] if single else answers


def problem_of(affinity: Affinity, fusion: Fusion | None = None) -> Problem:
    """The combinatorial problem that an affinity poses under a fusion."""
    with torch.no_grad():
        cost = affinity.cost(fusion)
        mean = affinity.scores.mean(0)
    return Problem(affinity.pairs, cost, distinct_views(affinity.view), mean)


def _association(problem: Problem, solution: Solution) -> Association:
    stats = dict(solution.stats)
    if solution.labels is None:
        if solution.links is None:
            raise RuntimeError("the solver returned neither labels nor links")
        objective = _cost_of_links(problem, solution.links)
        return Association(
            None, objective, solution.status, solution.lower_bound, stats, solution.links
        )
    labels = by_first_appearance(solution.labels.to(problem.view.device))
    if labels.shape != problem.view.shape:
        raise RuntimeError(f"the solver returned {len(labels)} labels for {len(problem)}")
    if not is_distinct(labels, problem.view):
        raise RuntimeError("the solver put two observations of one view into one cluster")
    objective = objective_of(problem, labels)
    return Association(labels, objective, solution.status, solution.lower_bound, stats)


def objective_of(problem: Problem, labels: Int64[Tensor, " m"]) -> float:
    """Sum of the cost over the pairs inside clusters, in float64."""
    together = labels[problem.pairs[0]] == labels[problem.pairs[1]]
    return float(problem.cost[together].double().sum())


def is_distinct(labels: Int64[Tensor, " m"], view: Int64[Tensor, " m"]) -> bool:
    """Whether no cluster holds two observations of one view."""
    if not len(labels):
        return True
    key = labels * (int(view.max()) + 1) + view
    return len(torch.unique(key)) == len(key)


def _cost_of_links(problem: Problem, links: Tensor) -> float:
    m = len(problem)
    listed = torch.isin(problem.pairs[0] * m + problem.pairs[1], links[0] * m + links[1])
    return float(problem.cost[listed].double().sum())
