"""MatchEIG: a low-rank approximation of the matches, made one-to-one between each two views."""

from __future__ import annotations

import torch

from mixer_torch.pairs import within_view
from mixer_torch.solvers.eigen import eigh
from mixer_torch.solvers.problem import Problem, Solution
from mixer_torch.solvers.synchronization import Synchronization, best_matches, solution_of_links


class MatchEIG(Synchronization):
    """The best approximation of rank k to the matches, made one-to-one between each two views.

        minimise  ‖X − (W + I)‖_F  subject to  rank X ≤ k

    is solved by the k eigenpairs of largest magnitude. As in the publication, X is rebuilt with
    the magnitudes of the eigenvalues, entries below a threshold are dropped, and each block (i, j)
    is projected on the partial permutations by linear assignment.

    Each block is projected alone, so matches are one-to-one but **need not be cycle consistent**:
    there are labels where they are, and only links where they are not.

    Needs k: estimated by :func:`~mixer_torch.solvers.synchronization.universe_size` unless given.
    Soft scores: see ``evidence``.

    Source: Maset, Arrigoni and Fusiello, Practical and efficient multi-view matching, ICCV 2017.

    Args:
        universe: The number of objects, None to estimate it.
        evidence: What scores become; :mod:`mixer_torch.solvers.synchronization` has the kinds.
        threshold: Least entry of X that can become a match; 0.25 as the authors set it.
    """

    def __init__(
        self, universe: int | None = None, evidence: str = "match", threshold: float = 0.25
    ) -> None:
        super().__init__(universe, evidence, threshold)

    def run(self, problem: Problem) -> Solution:
        weight, size = self.inputs(problem)
        values, vectors = eigh(weight + torch.eye(len(weight)).to(weight))
        leading = values.abs().argsort(descending=True)[:size]
        root = vectors[:, leading] * values[leading].abs().sqrt()
        approximation = root @ root.T
        pairs = (approximation >= self.threshold).triu(1).nonzero().T
        pairs = pairs[:, ~within_view(problem.view, pairs)]
        matches = best_matches(pairs, approximation[pairs[0], pairs[1]], problem.view)
        return solution_of_links(problem, matches, universe=size)
