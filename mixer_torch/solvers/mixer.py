"""MIXER: projected gradient descent on the relaxed problem of the paper, and refinement."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import ClassVar

import torch

from mixer_torch.association import Status
from mixer_torch.solvers.batch import ProblemBatch
from mixer_torch.solvers.gradient.batch import Batch, buckets
from mixer_torch.solvers.gradient.graduated_non_convexity import GraduatedNonConvexity, Precision
from mixer_torch.solvers.gradient.penalty_doubling import PenaltyDoubling, Projection
from mixer_torch.solvers.gradient.schedule import Schedule, choice
from mixer_torch.solvers.gradient.stage import GradientStage, Relaxed
from mixer_torch.solvers.parsimony import without_idle_links
from mixer_torch.solvers.problem import Problem, Solution, Solver
from mixer_torch.solvers.refinement import RESTARTS, Effort
from mixer_torch.solvers.search.decomposition import cut_along
from mixer_torch.solvers.search.greedy import greedy

RELAXING = 0.3  # share of the progress that is reported at the end of the gradient stage: a guess


class Mixer(Solver):
    """Multimodal, multiway association by the continuous relaxation of the paper.

    The gradient stage minimises the relaxed problem
    (:mod:`mixer_torch.solvers.gradient.relaxation`) until it is binary and feasible; where steps
    run out first, the nearest feasible labels are taken and the status says so. Each part of the
    problem that can be solved apart, and is not too large for dense matrices, goes through it, and
    the better of its answer and of greedy contraction is refined by discrete search with perturbed
    restarts; the result is never worse than either. :meth:`paper` is the algorithm of the paper.

    ``stats`` tells ``binary_without_rounding``, ``iterations``, the last ``penalty`` and the
    ``history`` of the relaxed objective; with refinement also the number of ``parts``, how many
    were ``relaxed``, the objective of each stage (``objective_greedy``, ``objective_gradient`` and
    ``objective_refined``), how many ``restarts`` ran, and ``gained``: what enumeration, descent,
    annealing and ruin and recreate have each lowered the objective by.

    Args:
        max_iterations: Steps of the gradient stage at most.
        schedule: How the relaxation becomes binary: an instance of :class:`GraduatedNonConvexity`
            or :class:`PenaltyDoubling` (the paper's), or their names, "anneal" and "penalty". If
            None, the former with refinement and the latter without.
        projection: Of ``PenaltyDoubling``, where it is not given as an instance.
        refine: Whether discrete search follows. Without, each problem is relaxed as a whole.
        restarts: Perturbed restarts of a part at most. Fewer run where they keep coming back to the
            same answer. More find better answers of hard problems, in proportionally more time.
        time_limit: Seconds, after which the best answer so far is returned; None for no limit.
        seed: Of all random draws.
        precision: Of ``GraduatedNonConvexity``, where it is not given as an instance.
        progress: Told the fraction that is done, now and then.

    Raises:
        ValueError: An argument is out of range.
    """

    takes_groups: ClassVar[bool] = True

    def __init__(
        self,
        max_iterations: int = 1000,
        schedule: Schedule | str | None = None,
        projection: str = "row_sum_at_most_one",
        refine: bool = True,
        restarts: int = RESTARTS,
        time_limit: float | None = None,
        seed: int = 0,
        precision: str = "float32",
        progress: Callable[[float], None] | None = None,
    ) -> None:
        choice("projection", projection, Projection)
        choice("precision", precision, Precision)
        schedule = _schedule(schedule or ("anneal" if refine else "penalty"), projection, precision)
        if max_iterations < 1:
            raise ValueError(f"max_iterations: expected at least 1, got {max_iterations}")
        if restarts < 0:
            raise ValueError(f"restarts: expected at least 0, got {restarts}")
        if time_limit is not None and not time_limit > 0:
            raise ValueError(f"time_limit: expected more than 0 seconds, got {time_limit}")
        self.refine = refine
        self.restarts = restarts
        self.time_limit = time_limit
        self.seed = seed
        self.progress = progress
        self.gradient = GradientStage(schedule, max_iterations, seed)

    @classmethod
    def paper(
        cls,
        max_iterations: int = 1000,
        projection: str = "row_sum_at_most_one",
        time_limit: float | None = None,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> Mixer:
        """The algorithm of the paper: its relaxation and schedule, and no discrete refinement.

        Each problem is relaxed as a whole, with as many columns as observations.

        Args:
            max_iterations: Steps of projected gradient descent at most.
            projection: Constraint on the rows of U, as in :class:`PenaltyDoubling`.
            time_limit: Seconds; problems that have not begun then come back unsolved, with every
                observation alone.
            seed: Of the small disturbances.
            progress: Told the fraction that is done, now and then.

        Raises:
            ValueError: An argument is out of range.
        """
        return cls(
            max_iterations,
            PenaltyDoubling(projection),
            refine=False,
            time_limit=time_limit,
            seed=seed,
            progress=progress,
        )

    def run(self, problem: Problem) -> Solution:
        return self.run_batch([problem])[0]

    def run_batch(self, problems: Sequence[Problem]) -> list[Solution]:
        limit = math.inf if self.time_limit is None else self.time_limit
        deadline = time.perf_counter() + limit
        alike: dict[tuple[torch.dtype, torch.device], list[int]] = {}
        for i, problem in enumerate(problems):
            alike.setdefault((problem.cost.dtype, problem.cost.device), []).append(i)
        solve = self._solve if self.refine else self._relax_alone
        answers: dict[int, Solution] = {}
        for group in alike.values():
            tell = self._teller(len(answers), len(group), len(problems))
            solutions = solve([problems[i] for i in group], deadline, tell)
            answers.update(zip(group, solutions, strict=True))
        return [answers[i] for i in range(len(problems))]

    def _solve(
        self, problems: list[Problem], deadline: float, tell: Callable[[float], None]
    ) -> list[Solution]:
        """The whole algorithm, on problems of one dtype on one device.

        1. The problems become one graph, which falls into parts that can be solved apart.
        2. Greedy contraction gives each part a first clustering.
        3. The gradient stage gives each part of a suitable size a second one.
        4. From the better of the two, each part is refined by discrete search.
        5. Clusters are split where no chain of negative costs holds them together.
        """
        batch = ProblemBatch.of(problems)
        contracted = cut_along(greedy(batch.graph), batch.parts)
        found = batch.relax(self.gradient, contracted, deadline, lambda part: tell(RELAXING * part))
        relaxed = batch.labels(found, contracted)
        start = batch.better(contracted, relaxed)
        effort = Effort(
            self.restarts,
            self.seed,
            deadline,
            lambda part: tell(RELAXING + (1 - RELAXING) * part),
        )
        refined, states, timed_out = batch.refine(start, effort)
        label = without_idle_links(batch.graph, refined)
        tell(1.0)
        stages = {"greedy": contracted, "gradient": relaxed, "refined": label}
        return batch.solutions(label, found, stages, states, timed_out)

    def _relax_alone(
        self, problems: list[Problem], deadline: float, tell: Callable[[float], None]
    ) -> list[Solution]:
        """The gradient stage alone, on each problem as a whole."""
        answers: dict[int, Relaxed] = {}
        for bucket in buckets([len(problem) for problem in problems], problems[0].cost.device):
            if time.perf_counter() >= deadline:
                break
            batch = Batch.of([problems[i] for i in bucket])
            relaxed = self.gradient.run(batch, batch.mask.shape[1])
            answers.update(zip(bucket, relaxed, strict=True))
            tell(len(answers) / len(problems))
        return [_relaxed_solution(problems[i], answers.get(i)) for i in range(len(problems))]

    def _teller(self, done: int, now: int, total: int) -> Callable[[float], None]:
        """What to tell of the progress of some of the problems, as a fraction of all of them."""

        def tell(fraction: float) -> None:
            if self.progress is not None:
                self.progress((done + fraction * now) / total)

        return tell


def _relaxed_solution(problem: Problem, relaxed: Relaxed | None) -> Solution:
    """The answer of the gradient stage; every observation alone where time ran out before."""
    if relaxed is None:
        labels = torch.arange(len(problem), device=problem.view.device)
        stats = {"iterations": 0, "history": [], "binary_without_rounding": False, "penalty": 0.0}
        return Solution(Status.TIME_LIMIT, labels, stats=stats)
    stats = {
        "iterations": relaxed.iterations,
        "history": relaxed.history,
        "binary_without_rounding": relaxed.binary,
        "penalty": relaxed.penalty,
    }
    status = Status.CONVERGED if relaxed.binary else Status.ROUNDED
    return Solution(status, labels=relaxed.labels, stats=stats)


def _schedule(given: Schedule | str, projection: str, precision: str) -> Schedule:
    """A schedule by its name, with what the constructor's other arguments say; objects as given."""
    if isinstance(given, Schedule):
        return given
    by_name = {
        "anneal": lambda: GraduatedNonConvexity(precision=precision),
        "penalty": lambda: PenaltyDoubling(projection),
    }
    if given not in by_name:
        raise ValueError(
            f"schedule: expected a Schedule or one of {', '.join(by_name)}, got {given!r}"
        )
    return by_name[given]()
