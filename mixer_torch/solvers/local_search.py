"""Greedy contraction and discrete moves alone, where every millisecond counts."""

from __future__ import annotations

from typing import ClassVar

import torch

from mixer_torch.association import Status
from mixer_torch.solvers.parsimony import without_idle_links
from mixer_torch.solvers.problem import Problem, Solution, Solver
from mixer_torch.solvers.refinement import refine
from mixer_torch.solvers.search.graph import Graph
from mixer_torch.solvers.search.greedy import greedy


class LocalSearch(Solver):
    """The refinement of :class:`~mixer_torch.solvers.mixer.Mixer` without its gradient stage.

    Greedy contraction (:func:`~mixer_torch.solvers.search.greedy.greedy`) gives clusters; node
    moves, linear assignment of one view, merges, Kernighan-Lin exchanges and perturbed restarts
    lower their cost (:func:`~mixer_torch.solvers.refinement.refine`). It takes a fraction of
    ``Mixer``'s time, and suits small problems that come one after the other and whose answers are
    in little doubt, as in online tracking. ``stats`` are those of :func:`refine`.

    Args:
        restarts: Perturbed restarts of a part at most.
        time_limit: Seconds after which no further restart begins; None for no limit.
        seed: Of all random draws.

    Raises:
        ValueError: An argument is out of range.
    """

    takes_groups: ClassVar[bool] = True

    def __init__(self, restarts: int = 10, time_limit: float | None = None, seed: int = 0) -> None:
        if restarts < 0:
            raise ValueError(f"restarts: expected at least 0, got {restarts}")
        if time_limit is not None and not time_limit > 0:
            raise ValueError(f"time_limit: expected more than 0 seconds, got {time_limit}")
        self.restarts = restarts
        self.time_limit = time_limit
        self.seed = seed

    def run(self, problem: Problem) -> Solution:
        graph = Graph.from_problem(problem)
        found, stats = refine(
            graph,
            greedy(graph),
            restarts=self.restarts,
            seed=self.seed,
            time_limit=self.time_limit,
        )
        labels = torch.from_numpy(without_idle_links(graph, found)).to(problem.view.device)
        status = Status.TIME_LIMIT if stats["timed_out"] else Status.CONVERGED
        return Solution(status, labels, stats=stats)
