"""Linear assignment from each view to the next, chained, as most trackers do."""

from __future__ import annotations

from mixer_torch.association import Status
from mixer_torch.solvers.problem import Problem, Solution, Solver
from mixer_torch.solvers.synchronization import (
    best_matches,
    between_consecutive_views,
    check_threshold,
    labels_of_links,
)


class Hungarian(Solver):
    """Optimal one-to-one matches between consecutive views, chained to tracks.

        maximise  sum of (score - threshold) over the matches between views i and i + 1
        subject to  at most one match an observation

    for each i apart. An object that is missed in one view starts a new track. Needs one score a
    pair and takes the mean of the modalities' (:attr:`Problem.score`) as the gain of a match, soft
    as it is; only scores between consecutive views are looked at. Views are taken to be numbered
    in the order of time, as in :class:`~mixer_torch.solvers.threshold.Consecutive`. Chains are
    consistent, so there are always labels.

    Source: Kuhn, The Hungarian method for the assignment problem, Naval Research Logistics
    Quarterly 2, 1955.

    Args:
        threshold: A match has to have a score above it.
    """

    def __init__(self, threshold: float = 0.5) -> None:
        self.threshold = check_threshold(threshold)

    def run(self, problem: Problem) -> Solution:
        near = between_consecutive_views(problem)
        gain = problem.score[near] - self.threshold
        matches = best_matches(problem.pairs[:, near], gain, problem.view)
        return Solution(Status.CONVERGED, labels=labels_of_links(matches, len(problem)))
