"""Shared parts of the comparison algorithms: input, size of the universe, and rounding to matches.

These algorithms know one score a pair, :attr:`Problem.score`, the mean of the modalities' scores,
and were published for binary matches, for which "not matched" and "nothing known" are both 0. How
a score becomes an entry of their matrix W is a choice, the same for all of them (``Evidence``):

- ``"match"``: 1 where the score is above 0.5, else 0. The input that the publications assume.
- ``"assignment"``: the same, made one-to-one for each two views by linear assignment (the most of
  score - 0.5), as a matcher of two views would.
- ``"attraction"``: max(0, 2 score - 1): soft, and 0 for a score of 0.5.
- ``"score"``: the score itself, 0.5 for a pair that is not listed. It misleads algorithms that read
  W_ab > 0 as evidence of a match, and is there to show that.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from mixer_torch.association import Status
from mixer_torch.solvers.eigen import eigh
from mixer_torch.solvers.problem import Problem, Solution, Solver, is_distinct

Evidence = Literal["match", "assignment", "attraction", "score"]


class Synchronization(Solver):
    """Base class of the spectral algorithms: their settings, and the input that is made of them.

    Args:
        universe: The number of objects, None to estimate it from the spectrum.
        evidence: What scores become.
        threshold: What it is compared with is said by each algorithm.
    """

    def __init__(
        self, universe: int | None = None, evidence: str = "match", threshold: float = 0.5
    ) -> None:
        self.universe = check_universe(universe)
        self.evidence = check_evidence(evidence)
        self.threshold = threshold

    def inputs(self, problem: Problem) -> tuple[Float[Tensor, "m m"], int]:
        """W, and the number of objects, as set or as estimated."""
        weight = evidence_matrix(problem, self.evidence)
        if self.universe is None:
            return weight, universe_size(weight, problem.view)
        return weight, bounded_universe(self.universe, problem.view)


def check_evidence(evidence: str) -> str:
    """ValueError unless it is one of the kinds of evidence."""
    if evidence not in get_args(Evidence):
        raise ValueError(
            f"evidence: expected one of {', '.join(get_args(Evidence))}, got {evidence!r}"
        )
    return evidence


def check_universe(universe: int | None) -> int | None:
    """ValueError unless it is None or at least 1."""
    if universe is not None and universe < 1:
        raise ValueError(f"universe: expected an integer >= 1 or None, got {universe}")
    return universe


def check_threshold(threshold: float) -> float:
    """ValueError unless it is in [0, 1]."""
    if not 0 <= threshold <= 1:
        raise ValueError(f"threshold: expected a number in [0, 1], got {threshold}")
    return threshold


def check_stopping(max_iterations: int, tolerance: float) -> None:
    """ValueError unless there is an iteration and a positive tolerance."""
    if max_iterations < 1:
        raise ValueError(f"max_iterations: expected at least 1, got {max_iterations}")
    if not tolerance > 0:
        raise ValueError(f"tolerance: expected a number > 0, got {tolerance}")


def between_consecutive_views(problem: Problem) -> Bool[Tensor, " P"]:
    """Which pairs are between a view and the next one."""
    first, second = problem.view[problem.pairs]
    return (first - second).abs() == 1


def evidence_matrix(problem: Problem, evidence: str) -> Float[Tensor, "m m"]:
    """W: symmetric, in [0, 1], 0 on the diagonal and within views."""
    m, score = len(problem), problem.score
    if evidence == "score":
        full = score.new_full((m, m), 0.5)
        full[problem.view[:, None] == problem.view] = 0
        weight = score
    else:
        full = score.new_zeros(m, m)
        weight = (2 * score - 1).clamp(min=0) if evidence == "attraction" else (score > 0.5)
    if evidence == "assignment":
        a, b = best_matches(problem.pairs, score - 0.5, problem.view)
        weight = torch.ones_like(a)
    else:
        a, b = problem.pairs
    weight = weight.to(full.dtype)
    full[a, b] = weight
    full[b, a] = weight
    return full


def normalized_laplacian(weight: Float[Tensor, "m m"]) -> Float[Tensor, "m m"]:
    """(D + I)^-1/2 (D - W) (D + I)^-1/2 for a W with an empty diagonal (Fathian et al. 2020).

    For noiseless matches its eigenvalues are 0, once for each object, and 1.
    """
    degree = weight.sum(1)
    scale = (degree + 1).rsqrt()
    return scale[:, None] * (torch.diag(degree) - weight) * scale


def universe_size(weight: Float[Tensor, "m m"], view: Int64[Tensor, " m"]) -> int:
    """How many objects there are: the eigenvalues of the normalised Laplacian below 0.5.

    The estimate of Fathian et al. (2020), who gave it to every algorithm in their comparison.
    """
    eigenvalues, _ = eigh(normalized_laplacian(weight))
    return bounded_universe(int((eigenvalues < 0.5).sum()), view)


def bounded_universe(size: int, view: Int64[Tensor, " m"]) -> int:
    """The size within its range: the observations of the largest view, to all of them."""
    return min(max(size, int(torch.bincount(view).max())), len(view))


def greedy_rounding(
    correlation: Float[Tensor, "m m"], view: Int64[Tensor, " m"], threshold: float = 0.5
) -> Int64[Tensor, " m"]:
    """Feasible labels from the correlations of observations (Zhou et al. 2015; Chen et al. 2014).

    View after view, each observation without a label starts an object, which takes from every
    other view the observation without a label that correlates most with it, if above a threshold.
    """
    value, views = correlation.detach().cpu().numpy(), view.cpu().numpy()
    labels = np.full(len(views), -1, dtype=np.int64)
    for seed in np.argsort(views, kind="stable"):
        if labels[seed] >= 0:
            continue
        free = (labels < 0) & (views != views[seed]) & (value[seed] > threshold)
        candidates = np.flatnonzero(free)
        candidates = candidates[np.argsort(-value[seed, candidates], kind="stable")]
        _, first = np.unique(views[candidates], return_index=True)
        labels[candidates[first]] = seed
        labels[seed] = seed
    return torch.from_numpy(labels).to(view.device)


def best_matches(
    pairs: Int64[Tensor, "2 P"], gain: Float[Tensor, " P"], view: Int64[Tensor, " m"]
) -> Int64[Tensor, "2 Q"]:
    """Between each two views, the one-to-one matches of the largest total gain.

        maximise  sum of gain over the matches
        subject to  each observation has at most one match in each other view

    Pairs that gain nothing are never matched. A pair without a competitor is matched at once, and a
    linear assignment is solved for the others only.
    """
    a, b = pairs.cpu().numpy()
    value, views = gain.detach().cpu().double().numpy(), view.cpu().numpy()
    kept = np.flatnonzero(value > 0)
    a, b, value = a[kept], b[kept], value[kept]
    flip = views[a] > views[b]
    a, b = np.where(flip, b, a), np.where(flip, a, b)
    block = views[a] * (views.max(initial=0) + 1) + views[b]
    row = np.unique(block * len(views) + a, return_inverse=True)[1]
    column = np.unique(block * len(views) + b, return_inverse=True)[1]
    taken = (np.bincount(row)[row] == 1) & (np.bincount(column)[column] == 1)
    order = np.argsort(block, kind="stable")
    order = order[~taken[order]]
    cuts = np.flatnonzero(np.diff(block[order])) + 1
    for entries in np.split(order, cuts) if len(order) else []:
        rows, i = np.unique(a[entries], return_inverse=True)
        columns, j = np.unique(b[entries], return_inverse=True)
        table = np.zeros((len(rows), len(columns)))
        table[i, j] = value[entries]
        chosen = np.zeros_like(table, dtype=bool)
        chosen[linear_sum_assignment(table, maximize=True)] = True
        taken[entries] = chosen[i, j]
    return pairs[:, torch.from_numpy(kept[np.flatnonzero(taken)]).to(pairs.device)]


def labels_of_links(links: Int64[Tensor, "2 Q"], m: int) -> Int64[Tensor, " m"]:
    """The connected components of the links."""
    ends = links.cpu().numpy()
    graph = coo_array((np.ones(ends.shape[1], dtype=np.int8), (ends[0], ends[1])), shape=(m, m))
    labels = connected_components(graph, directed=False)[1]
    return torch.from_numpy(labels.astype(np.int64)).to(links.device)


def solution_of_links(problem: Problem, links: Int64[Tensor, "2 Q"], **stats: Any) -> Solution:
    """Labels if the links are consistent: transitive, and distinct in each view. Else the links."""
    labels = labels_of_links(links, len(problem))
    size = torch.bincount(labels)
    transitive = int((size * (size - 1) // 2).sum()) == links.shape[1]
    if transitive and is_distinct(labels, problem.view):
        return Solution(Status.CONVERGED, labels=labels, stats=stats)
    return Solution(Status.INCONSISTENT, links=links, stats=stats)
