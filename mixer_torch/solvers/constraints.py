"""Constraints that users ask for, and the smaller problem that honours them by construction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Bool, Int64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from torch import Tensor

from mixer_torch.affinity import waive
from mixer_torch.association import by_first_appearance, links_of
from mixer_torch.observations import distinct_views
from mixer_torch.solvers.problem import Problem, Solution


@dataclass(frozen=True)
class Reduction:
    """A problem each of whose nodes is one observation, or several that must-link pairs connect.

    A node has the views of all of its observations, and may not share a cluster with another node
    that has one of them; two nodes that a cannot-link pair names are a cannot-link group of their
    own. The cost between two nodes is the sum over their pairs of observations; the cost inside a
    node is a constant.

    Args:
        problem: The smaller problem. Where the constraints change nothing, the one that came.
        node: (m,) the node of each observation.
        offset: Cost of the listed pairs inside nodes.
        cannot_link: (2, K) the cannot-link pairs of observations.
    """

    problem: Problem
    node: Int64[Tensor, " m"]
    offset: float
    cannot_link: Int64[Tensor, "2 K"]

    def expand(self, solution: Solution) -> Solution:
        """The solution of the smaller problem, with a label for every observation."""
        labels, links, bound = solution.labels, solution.links, solution.lower_bound
        if labels is not None:
            labels = labels.to(self.node.device)[self.node]
        if links is not None:
            links = self._members(links)
        bound = None if bound is None else bound + self.offset
        return replace(solution, labels=labels, links=links, lower_bound=bound)

    def broken(self, labels: Int64[Tensor, " m"]) -> str | None:
        """Which must-link or cannot-link pair labels break; None if they honour all."""
        if len(self.problem) == len(self.node) and not self.cannot_link.shape[1]:
            return None  # there are none, and to look would make the host wait for a device
        first = torch.zeros_like(self.node)
        place = torch.arange(len(self.node), device=self.node.device)
        first = first.scatter_reduce(0, self.node, place, "amin", include_self=False)
        split = (labels != labels[first[self.node]]).nonzero()
        if len(split):
            i = int(split[0, 0])
            return f"must_link of {int(first[self.node[i]])} and {i}"
        joined = (labels[self.cannot_link[0]] == labels[self.cannot_link[1]]).nonzero()
        if len(joined):
            a, b = self.cannot_link[:, joined[0, 0]].tolist()
            return f"cannot_link ({a}, {b})"
        return None

    def _members(self, links: Int64[Tensor, "2 Q"]) -> Int64[Tensor, "2 R"]:
        """All pairs of observations that links between nodes stand for, and those inside nodes."""
        links = links.to(self.node.device)
        order = torch.argsort(self.node, stable=True)
        size = torch.bincount(self.node, minlength=len(self.problem))
        start = torch.cumsum(size, 0) - size
        count = size[links[0]] * size[links[1]]
        which = torch.repeat_interleave(torch.arange(len(count), device=count.device), count)
        rank = (
            torch.arange(len(which), device=count.device) - (torch.cumsum(count, 0) - count)[which]
        )
        width = size[links[1]][which]
        a = order[start[links[0]][which] + rank // width]
        b = order[start[links[1]][which] + rank % width]
        return torch.cat(
            [torch.stack([torch.minimum(a, b), torch.maximum(a, b)]), links_of(self.node)], 1
        )


def constrain(
    problem: Problem,
    view: Int64[Tensor, " m"],
    must_link: Any = None,
    cannot_link: Any = None,
    indistinct: Any = None,
) -> tuple[Problem, Reduction]:
    """The problem without the distinctness that is waived, and its reduction by linked pairs.

    Args:
        problem: The problem that the affinity poses.
        view: The affinity's view, negative for none.
        must_link: (2, K) pairs that are the same.
        cannot_link: (2, K) pairs that are not.
        indistinct: Views in which distinctness does not hold.

    Raises:
        ValueError: An argument is malformed, or the constraints contradict one another or
            distinctness; the message names the pairs.
    """
    must = linked_pairs("must_link", must_link, view)
    cannot = linked_pairs("cannot_link", cannot_link, view)
    if indistinct is not None:
        view = waive(view, indistinct)
        problem = replace(problem, view=distinct_views(view))
    if not must.shape[1] and not cannot.shape[1]:
        node = torch.arange(len(view), device=view.device)
        return problem, Reduction(problem, node, 0.0, cannot)
    node = _nodes(must, len(view))
    _check(node, must, cannot, view)
    return problem, _reduce(problem, node, cannot)


def linked_pairs(name: str, value: Any, view: Int64[Tensor, " m"]) -> Int64[Tensor, "2 K"]:
    """Pairs of different observations as a (2, K) int64 tensor, or a ValueError naming them."""
    if value is None:
        return torch.zeros(2, 0, dtype=torch.int64, device=view.device)
    pairs = torch.as_tensor(value)
    if pairs.numel() == 0 and pairs.ndim in (1, 2):
        pairs = torch.zeros(2, 0, dtype=torch.int64)
    if pairs.ndim != 2 or len(pairs) != 2 or pairs.is_floating_point() or pairs.dtype == torch.bool:
        raise ValueError(
            f"{name}: expected integers of shape (2, K), "
            f"got {pairs.dtype} of shape {tuple(pairs.shape)}"
        )
    pairs = pairs.to(view.device, torch.int64)
    wrong = ((pairs < 0) | (pairs >= len(view))).any(0) | (pairs[0] == pairs[1])
    if bool(wrong.any()):
        a, b = pairs[:, wrong.nonzero()[0, 0]].tolist()
        raise ValueError(
            f"{name}: expected pairs of different observations in 0..{len(view) - 1}, "
            f"got ({a}, {b})"
        )
    return pairs


def _nodes(must: Int64[Tensor, "2 K"], m: int) -> Int64[Tensor, " m"]:
    a, b = must.cpu().numpy()
    label = connected_components(coo_array(([1] * len(a), (a, b)), shape=(m, m)), False)[1]
    return by_first_appearance(torch.as_tensor(label, dtype=torch.int64)).to(must.device)


def _check(node: Tensor, must: Tensor, cannot: Tensor, view: Tensor) -> None:
    """ValueError where must-link chains join two of one view or a cannot-link pair."""
    joined = (node[cannot[0]] == node[cannot[1]]).nonzero()
    if len(joined):
        a, b = cannot[:, joined[0, 0]].tolist()
        raise ValueError(
            f"cannot_link: ({a}, {b}) contradicts must_link, which joins them: "
            f"{_chain(must, len(view), a, b)}"
        )
    seen = (view >= 0).nonzero()[:, 0]
    key = node[seen] * len(view) + torch.unique(view[seen], return_inverse=True)[1]
    key, order = torch.sort(key, stable=True)
    twice = (key[1:] == key[:-1]).nonzero()
    if len(twice):
        a, b = seen[order[twice[0, 0] + torch.arange(2, device=order.device)]].tolist()
        raise ValueError(
            f"must_link: {_chain(must, len(view), a, b)} joins {a} and {b}, which are both of view "
            f"{int(view[a])} and so distinct; leave out a pair, or name the view in indistinct"
        )


def _chain(must: Tensor, m: int, a: int, b: int) -> str:
    first, second = must.cpu().numpy()
    graph = coo_array(([1] * len(first), (first, second)), shape=(m, m)).tocsr()
    before = breadth_first_order(graph, b, directed=False)[1]
    steps = []
    while a != b:
        steps.append(f"({a}, {before[a]})")
        a = int(before[a])
    return ", ".join(steps)


def _reduce(problem: Problem, node: Tensor, cannot: Tensor) -> Reduction:
    count = int(node.max()) + 1
    inside = node[problem.pairs[0]] == node[problem.pairs[1]]
    offset = float(problem.cost[inside].double().sum())
    groups = _cannot_link_groups(problem, node, cannot)
    ends = node[problem.pairs]
    low, high = ends.min(0).values, ends.max(0).values
    keep = ~inside & ~_conflicting(groups, low, high, count)
    key, order = torch.sort((low * count + high)[keep], stable=True)
    key, size = torch.unique_consecutive(key, return_counts=True)
    cost = _sums(problem.cost[keep][order].double(), size).to(problem.cost.dtype)
    score = _sums(problem.score[keep][order].double(), size) / size
    pairs = torch.stack([key // count, key % count])
    reduced = Problem(
        pairs, cost, torch.arange(count, device=node.device), score.to(problem.score.dtype), groups
    )
    return Reduction(reduced.simplified(), node, offset, cannot)


def _sums(value: Tensor, size: Tensor) -> Tensor:
    """Sums of consecutive runs, in an order that does not depend on the device."""
    if not len(size):
        return value[:0]
    return torch.segment_reduce(value, "sum", lengths=size)


def _cannot_link_groups(problem: Problem, node: Tensor, cannot: Tensor) -> Int64[Tensor, "2 K"]:
    """(node, group) pairs: the views of each node, and one more group for each cannot-link pair."""
    base = int(problem.view.max()) + 1
    extra = base + torch.arange(cannot.shape[1], device=node.device)
    member = torch.cat([node, node[cannot[0]], node[cannot[1]]])
    return torch.stack([member, torch.cat([problem.view, extra, extra])])


def _conflicting(groups: Tensor, low: Tensor, high: Tensor, count: int) -> Bool[Tensor, " P"]:
    """Which of the pairs of nodes have a cannot-link group in common.

    The groups of the end that is in fewer are looked up at the other end: as many steps as there
    are pairs, whatever the size of the views.
    """
    node, group = groups[:, torch.argsort(groups[0], stable=True)]
    size = torch.bincount(node, minlength=count)
    few = torch.where(size[low] <= size[high], low, high)
    which = torch.repeat_interleave(torch.arange(len(few), device=few.device), size[few])
    begin = torch.cumsum(size[few], 0) - size[few]
    entry = (torch.cumsum(size, 0) - size)[few][which] - begin[which]
    entry += torch.arange(len(which), device=few.device)
    width = int(group.max()) + 1
    common = torch.isin((low + high - few)[which] * width + group[entry], node * width + group)
    clash = torch.zeros_like(low, dtype=torch.bool)
    clash[which[common]] = True
    return clash
