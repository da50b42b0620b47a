"""What a solver is given, what it returns, and what it is: the ground floor of the solvers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from mixer_torch.affinity import Affinity
from mixer_torch.association import Status
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
        groups: (2, K) int64 cannot-link groups, or None where each node has one view and ``view``
            says it all. Where must-link or cannot-link pairs are given, a node is one or several
            observations and has a set of views: column (a, g) says that node a is in group g, and
            two nodes of one group may not share a cluster. ``view`` is then 0..m-1 and says
            nothing. Only a solver whose class says ``takes_groups`` is given such a problem.
    """

    pairs: Int64[Tensor, "2 P"]
    cost: Float[Tensor, " P"]
    view: Int64[Tensor, " m"]
    score: Float[Tensor, " P"]
    groups: Int64[Tensor, "2 K"] | None = None

    def __len__(self) -> int:
        """m, the number of observations."""
        return len(self.view)

    @property
    def incidence(self) -> Int64[Tensor, "2 K"]:
        """(2, K) which node is in which cannot-link group; the views where there are no groups."""
        if self.groups is not None:
            return self.groups
        return torch.stack([torch.arange(len(self), device=self.view.device), self.view])

    def conflicts(self) -> Bool[Tensor, "m m"]:
        """The conflict mask, P_d of the paper: which nodes have a cannot-link group in common."""
        if self.groups is None:
            conflict = self.view[:, None] == self.view
        else:
            group = torch.unique(self.groups[1], return_inverse=True)[1]
            has = self.cost.new_zeros(len(self), int(group.max()) + 1 if len(group) else 0)
            has[self.groups[0], group] = 1
            conflict = has @ has.T > 0
        return conflict.fill_diagonal_(False)

    def simplified(self) -> Problem:
        """The same problem without groups of a single node, as plain views if possible."""
        if self.groups is None:
            return self
        group, size = torch.unique(self.groups[1], return_inverse=True, return_counts=True)[1:]
        node, group = self.groups[0][size[group] > 1], group[size[group] > 1]
        if len(node) and int(torch.bincount(node).max()) > 1:
            return replace(self, groups=torch.stack([node, group]))
        view = torch.full_like(self.view, -1)
        view[node] = group
        return replace(self, view=distinct_views(view), groups=None)

    def dense_cost(self) -> Float[Tensor, "m m"]:
        """The symmetric matrix Ā of fused costs, 0 on the diagonal and within views."""
        full = self.cost.new_zeros(len(self), len(self))
        full[self.pairs[0], self.pairs[1]] = self.cost
        full[self.pairs[1], self.pairs[0]] = self.cost
        return full


@dataclass(frozen=True)
class Solution:
    """What a solver returns: labels (m,) of any integers, or, if it has none, links (2, Q).

    Labels may be on the CPU wherever the problem is.
    """

    status: Status
    labels: Tensor | None = None
    links: Tensor | None = None
    lower_bound: float | None = None
    stats: Mapping[str, Any] = field(default_factory=dict)


class Solver(ABC):
    """An algorithm. Its constructor takes the settings; ``solve()`` does the rest.

    ``takes_groups`` says whether it can solve a problem whose nodes have sets of views, which is
    what must-link and cannot-link pairs lead to. One that cannot is only given such constraints
    where each group of linked observations is of one view at most.
    """

    takes_groups: ClassVar[bool] = False

    @abstractmethod
    def run(self, problem: Problem) -> Solution:
        """Solve one problem with m >= 1, on the device of its tensors, writing to none of them."""

    def run_batch(self, problems: Sequence[Problem]) -> list[Solution]:
        """Solve several; one after the other unless a solver knows better."""
        return [self.run(problem) for problem in problems]


def problem_of(
    affinity: Affinity, fusion: Fusion | None = None, view: Int64[Tensor, " m"] | None = None
) -> Problem:
    """The combinatorial problem that an affinity poses under a fusion.

    Args:
        affinity: Scores of pairs.
        fusion: How modalities add up; the paper's ``LinearFusion()`` if None.
        view: ``distinct_views(affinity.view)``, where it has been computed before.
    """
    with torch.no_grad():
        view = distinct_views(affinity.view) if view is None else view
        return Problem(affinity.pairs, affinity.cost(fusion), view, affinity.scores.mean(0))


def objective_of(problem: Problem, labels: Int64[Tensor, " m"]) -> float:
    """Sum of the cost over the pairs inside clusters, in float64."""
    return float(cost_inside(problem, labels))


def cost_inside(problem: Problem, labels: Int64[Tensor, " m"]) -> Float[Tensor, ""]:
    """Sum of the cost over the pairs inside clusters, where the problem is."""
    return _sum_of(problem.cost, labels[problem.pairs[0]] == labels[problem.pairs[1]])


def is_distinct(labels: Int64[Tensor, " m"], view: Int64[Tensor, " m"]) -> bool:
    """Whether no cluster holds two observations of one view."""
    if not len(labels):
        return True
    key = labels * (int(view.max()) + 1) + view
    return len(torch.unique(key)) == len(key)


def cost_of_links(problem: Problem, links: Int64[Tensor, "2 Q"]) -> Float[Tensor, ""]:
    """Sum of the cost over the listed pairs that are among the links, where the problem is."""
    m = len(problem)
    listed = torch.isin(problem.pairs[0] * m + problem.pairs[1], links[0] * m + links[1])
    return _sum_of(problem.cost, listed)


def _sum_of(cost: Tensor, chosen: Tensor) -> Float[Tensor, ""]:
    """In float64. On a device nothing is picked: the host would wait to learn how much it is."""
    if cost.device.type == "cpu":
        return cost[chosen].double().sum()
    return torch.where(chosen, cost, 0).sum(dtype=torch.float64)
