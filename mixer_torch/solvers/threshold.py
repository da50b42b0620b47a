"""The paper's two naïve baselines: links are the pairs whose score is above a threshold."""

from __future__ import annotations

from mixer_torch.solvers.problem import Problem, Solution, Solver
from mixer_torch.solvers.synchronization import (
    between_consecutive_views,
    check_threshold,
    solution_of_links,
)


class AllPairs(Solver):
    """A pair is the same if its score is above a threshold; nothing makes the links consistent.

    Needs one score a pair and takes the mean of the modalities' (:attr:`Problem.score`), so a soft
    score counts only by the side of the threshold on which it lies. A pair that is not listed is
    no link. Labels are given where the links happen to be consistent.

    Source: Lusk et al., MIXER, 2021, section V ("all-pairs").

    Args:
        threshold: Links are the pairs whose score is above it.
    """

    def __init__(self, threshold: float = 0.5) -> None:
        self.threshold = check_threshold(threshold)

    def run(self, problem: Problem) -> Solution:
        return solution_of_links(problem, problem.pairs[:, problem.score > self.threshold])


class Consecutive(AllPairs):
    """:class:`AllPairs`, between temporally consecutive views only.

    Views are taken to be numbered in the order of time, as the datasets here number them: the view
    after another is the one with the next larger number among those that have observations.

    Source: Lusk et al., MIXER, 2021, section V ("consecutive").

    Args:
        threshold: Links are the pairs whose score is above it.
    """

    def run(self, problem: Problem) -> Solution:
        linked = (problem.score > self.threshold) & between_consecutive_views(problem)
        return solution_of_links(problem, problem.pairs[:, linked])
