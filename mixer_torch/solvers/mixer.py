"""MIXER: projected gradient descent on the relaxed problem of the paper, and refinement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar, Literal, get_args

import torch

from mixer_torch.association import Status
from mixer_torch.solvers.gradient.batch import Batch, buckets
from mixer_torch.solvers.gradient.stage import GradientStage, Relaxed
from mixer_torch.solvers.joint import Clock, solve_side_by_side
from mixer_torch.solvers.problem import Problem, Solution, Solver
from mixer_torch.solvers.refinement import RESTARTS

Schedule = Literal["anneal", "penalty"]
Projection = Literal["row_sum_at_most_one", "simplex"]
Precision = Literal["float32", "tf32", "bfloat16"]


class Mixer(Solver):
    """Multimodal, multiway association by the continuous relaxation of the paper.

    The gradient stage minimises the relaxed problem (:mod:`mixer_torch.solvers.gradient.relaxation`) until
    it is binary and feasible; where steps run out first, the nearest feasible labels are taken and
    the status says so. With refinement, each part of the problem that can be solved apart, and is
    not too large for dense matrices, goes through it, and the better of its answer and of greedy
    contraction is refined by discrete moves and perturbed restarts; the result is never worse than
    either. ``Mixer(refine=False)`` is the algorithm of the paper, on the problem as a whole.

    ``stats`` tells ``binary_without_rounding``, ``iterations``, the last ``penalty`` and the
    ``history`` of the relaxed objective; with refinement also the number of ``parts``, how many
    were ``relaxed``, the objective of each stage (``objective_greedy``, ``objective_gradient`` and
    ``objective_refined``), how many ``restarts`` ran, and ``gained``: what enumeration, descent,
    annealing and ruin and recreate have each lowered the objective by.

    Args:
        max_iterations: Steps of the gradient stage at most. Annealing takes 100, and is followed by
            the paper's schedule only where its result is not binary.
        schedule: How the relaxation becomes binary: "anneal" sweeps it from convex to concave,
            "penalty" is the paper's, with doubled penalties and Armijo line search. If None,
            "anneal" with refinement, "penalty" without.
        projection: Constraint on the rows of U in the paper's schedule: "row_sum_at_most_one", as
            in the paper, or "simplex" (row sum 1), as in the authors' later version. Annealing
            needs row sums of 1.
        refine: Whether discrete moves follow. Without, this is the algorithm of the paper.
        restarts: Perturbed restarts of a part at most. Fewer run where they keep coming back to the
            same answer. More find better answers of hard problems, in proportionally more time.
        time_limit: Seconds, after which the best answer so far is returned; None for no limit.
        seed: Of all random draws.
        precision: Of the matrix products when annealing: "float32" (or float64, where the scores
            are), "tf32" or "bfloat16".
        progress: Told the fraction that is done, now and then.

    Raises:
        ValueError: An argument is out of range.
    """

    takes_tokens: ClassVar[bool] = True

    def __init__(
        self,
        max_iterations: int = 1000,
        schedule: str | None = None,
        projection: str = "row_sum_at_most_one",
        refine: bool = True,
        restarts: int = RESTARTS,
        time_limit: float | None = None,
        seed: int = 0,
        precision: str = "float32",
        progress: Callable[[float], None] | None = None,
    ) -> None:
        schedule = schedule or ("anneal" if refine else "penalty")
        _check("schedule", schedule, Schedule)
        _check("projection", projection, Projection)
        _check("precision", precision, Precision)
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
        self.gradient = GradientStage(schedule, projection, max_iterations, seed, precision)

    def run(self, problem: Problem) -> Solution:
        return self.run_batch([problem])[0]

    def run_batch(self, problems: Sequence[Problem]) -> list[Solution]:
        groups: dict[tuple[torch.dtype, torch.device], list[int]] = {}
        for i, problem in enumerate(problems):
            groups.setdefault((problem.cost.dtype, problem.cost.device), []).append(i)
        clock = Clock(self.time_limit)
        answers: dict[int, Solution] = {}
        for group in groups.values():
            chosen = [problems[i] for i in group]
            tell = self._teller(len(answers), len(group), len(problems))
            if self.refine:
                solutions = solve_side_by_side(
                    chosen, self.gradient, self.restarts, self.seed, clock, tell
                )
            else:
                solutions = self._relaxed(chosen, clock, tell)
            answers.update(zip(group, solutions, strict=True))
        return [answers[i] for i in range(len(problems))]

    def _relaxed(
        self, problems: list[Problem], clock: Clock, tell: Callable[[float], None]
    ) -> list[Solution]:
        """The gradient stage alone, on each problem as a whole."""
        answers: dict[int, Relaxed] = {}
        for bucket in buckets([len(problem) for problem in problems], problems[0].cost.device):
            if clock.is_over():
                break
            batch = Batch.of([problems[i] for i in bucket])
            relaxed = self.gradient.run(batch, batch.mask.shape[1])
            answers.update(zip(bucket, relaxed, strict=True))
            tell(len(answers) / len(problems))
        return [_solution(problems[i], answers.get(i)) for i in range(len(problems))]

    def _teller(self, done: int, now: int, total: int) -> Callable[[float], None]:
        """What to tell of the progress of some of the problems, as a fraction of all of them."""

        def tell(fraction: float) -> None:
            if self.progress is not None:
                self.progress((done + fraction * now) / total)

        return tell


def _solution(problem: Problem, relaxed: Relaxed | None) -> Solution:
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


def _check(name: str, value: str, choice: object) -> None:
    if value not in get_args(choice):
        raise ValueError(f"{name}: expected one of {', '.join(get_args(choice))}, got {value!r}")
