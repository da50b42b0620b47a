"""The problem as a weighted graph whose nodes are sets of observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.problem import Problem
from mixer_torch.solvers.transfer import on_host


@dataclass(frozen=True)
class Graph:
    """Correlation clustering with cannot-link groups, as NumPy arrays on the CPU.

        minimise  sum of cost over the pairs of nodes inside clusters
        subject to  no cluster holds two nodes of one group

    A node is one observation, whose group is its view, or several observations that stay together,
    which are in the groups of all of their views. A cannot-link pair is a group of two nodes. Two
    nodes of one group have no edge, and groups of a single node are left out: neither can change
    the answer.

    Args:
        start: (n + 1,) int64; the edges of node i are ``start[i]:start[i + 1]``.
        neighbour: (E,) int32 the other end. Each pair is listed from both ends, neighbours ascend.
        cost: (E,) float64, negative attracts.
        group_start: (n + 1,) int64; the groups of node i are ``group_start[i]:group_start[i + 1]``.
        group: (K,) int32 >= 0, ascending within a node.
    """

    start: np.ndarray
    neighbour: np.ndarray
    cost: np.ndarray
    group_start: np.ndarray
    group: np.ndarray

    def __len__(self) -> int:
        """n, the number of nodes."""
        return len(self.start) - 1

    @property
    def near(self) -> np.ndarray:
        """(E,) int32 the near end of each edge: the node in whose list it stands."""
        return np.repeat(np.arange(len(self), dtype=np.int32), np.diff(self.start))

    @property
    def group_node(self) -> np.ndarray:
        """(K,) int64 the node of each entry of ``group``."""
        return np.repeat(np.arange(len(self)), np.diff(self.group_start))

    @classmethod
    def from_problem(cls, problem: Problem) -> Graph:
        """One node an observation; its groups are those of the problem, or else its view."""
        return cls.from_problems([problem])

    @classmethod
    def from_problems(cls, problems: Sequence[Problem]) -> Graph:
        """Several problems as one graph, with no edge and no group in common.

        The search is sequential and needs the graph on the host: all problems of one dtype are
        brought from a device in one copy, because each copy waits for the device.
        """
        none = np.zeros((2, 0), np.int64)
        pairs, cost, incidence, nodes, groups = [none], [np.zeros(0)], [none], 0, 0
        copies = on_host([x for p in problems for x in (p.incidence, p.pairs, p.cost)])
        for i, problem in enumerate(problems):
            (node, group), ends, value = (copy.numpy() for copy in copies[3 * i : 3 * i + 3])
            pairs.append(ends + nodes)
            cost.append(value)
            incidence.append(np.stack([node + nodes, group + groups]))
            nodes += len(problem)
            groups += int(group.max()) + 1 if len(group) else 0
        return cls.from_arrays(
            nodes, np.concatenate(pairs, 1), np.concatenate(cost), np.concatenate(incidence, 1)
        )

    @classmethod
    def from_arrays(cls, n: int, pairs: Any, cost: Any, groups: Any) -> Graph:
        """From pairs of nodes and pairs (node, group), each in any order.

        Args:
            n: Number of nodes.
            pairs: (2, P) integers; the costs of a pair that is listed twice, in either order, add.
            cost: (P,) float.
            groups: (2, K) integers: node and group; repeated entries count once.
        """
        group_start, group = _group_lists(n, np.asarray(groups))
        pairs, cost = np.asarray(pairs), np.asarray(cost, np.float64)
        keep = _worth_an_edge(pairs[0], pairs[1], cost, group_start, group)
        first = pairs[0][keep].astype(np.int32)
        second = pairs[1][keep].astype(np.int32)
        start, neighbour, value = _adjacency(n, first, second, cost[keep])
        return cls(start, neighbour, value, group_start, group)

    def contract(self, label: np.ndarray) -> Graph:
        """The graph whose nodes are clusters: costs between two of them add, their groups unite.

        Args:
            label: (n,) integers 0..k-1, each in use, feasible. The new graph leaves out the cost
                inside clusters, which is the :meth:`objective` of the label.
        """
        label, near = np.asarray(label), self.near
        upper = near < self.neighbour
        pairs = np.stack([label[near[upper]], label[self.neighbour[upper]]])
        k = int(label.max()) + 1 if len(label) else 0
        groups = np.stack([label[self.group_node], self.group])
        return Graph.from_arrays(k, pairs, self.cost[upper], groups)

    def subgraph(self, nodes: np.ndarray) -> Graph:
        """The graph of some nodes, renumbered 0.. in their order."""
        place = np.full(len(self), -1)
        place[nodes] = np.arange(len(nodes))
        edge, near = _entries(self.start, nodes)
        far = place[self.neighbour[edge]]
        once = near < far
        entry, owner = _entries(self.group_start, nodes)
        pairs, groups = np.stack([near, far])[:, once], np.stack([owner, self.group[entry]])
        return Graph.from_arrays(len(nodes), pairs, self.cost[edge[once]], groups)

    def members(self) -> tuple[np.ndarray, np.ndarray]:
        """The nodes of each group, as :func:`group_members` lists them."""
        return group_members(self.group_start, self.group)

    def objective(self, label: np.ndarray) -> float:
        """Sum of the cost over the pairs inside clusters."""
        return float(self.objective_by_part(label, np.zeros(len(self), np.int64), 1)[0])

    def objective_by_part(self, label: np.ndarray, part: np.ndarray, parts: int) -> np.ndarray:
        """(parts,) the same sum for each part of the nodes; each cluster lies within one part."""
        return _objective(self.start, self.neighbour, self.cost, label, part, parts)

    def is_feasible(self, label: np.ndarray) -> bool:
        """Whether no cluster holds two nodes of one group."""
        if not len(self.group):
            return True
        owner = np.asarray(label, dtype=np.int64)[self.group_node]
        key = owner * (int(self.group.max()) + 1) + self.group
        return len(np.unique(key)) == len(key)


def arrays_of(graph: Graph) -> tuple[np.ndarray, ...]:
    """start, neighbour, cost, group_start, group: the arguments of compiled kernels."""
    return graph.start, graph.neighbour, graph.cost, graph.group_start, graph.group


def compact(label: np.ndarray) -> np.ndarray:
    """The same clusters, numbered 0.. without holes (int64)."""
    return np.unique(label, return_inverse=True)[1].astype(np.int64).reshape(-1)


def named_by_member(label: np.ndarray) -> np.ndarray:
    """The same clusters, each with its first member as label (int64)."""
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    return first.astype(np.int64)[inverse.reshape(-1)]


def _group_lists(n: int, groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """CSR of the groups of at least two nodes, renumbered 0.. in order."""
    if not groups.shape[1]:
        return np.zeros(n + 1, np.int64), np.zeros(0, np.int32)
    value = np.unique(groups[1], return_inverse=True)[1].astype(np.int64).reshape(-1)
    count = int(value.max()) + 1
    key = np.unique(groups[0].astype(np.int64) * count + value)
    node, value = key // count, key % count
    members = np.bincount(value, minlength=count)
    keep = members[value] > 1
    node, value = node[keep], value[keep]
    renumbered = np.cumsum(members > 1) - 1
    start = np.zeros(n + 1, np.int64)
    np.cumsum(np.bincount(node, minlength=n), out=start[1:])
    return start, renumbered[value].astype(np.int32)


@compiled
def share_group(group_start: np.ndarray, group: np.ndarray, a: int, b: int) -> bool:
    """Whether nodes a and b are in one group."""
    i, j = group_start[a], group_start[b]
    while i < group_start[a + 1] and j < group_start[b + 1]:
        if group[i] == group[j]:
            return True
        if group[i] < group[j]:
            i += 1
        else:
            j += 1
    return False


@compiled
def _worth_an_edge(first, second, cost, group_start, group):
    """Which pairs become edges: two nodes that may be together, and a cost that is not 0."""
    keep = np.zeros(len(cost), np.bool_)
    for p in range(len(cost)):
        a, b = first[p], second[p]
        keep[p] = cost[p] != 0 and a != b and not share_group(group_start, group, a, b)
    return keep


@compiled
def _adjacency(n, first, second, cost):
    """CSR with ascending neighbours and repeated pairs added up.

    Two passes of counting sort: by the far end, then, stably, by the near end. Then the lists,
    which are shorter where pairs were repeated, are moved together.
    """
    count = np.zeros(n + 1, np.int64)
    for p in range(len(cost)):
        count[first[p] + 1] += 1
        count[second[p] + 1] += 1
    start = np.cumsum(count)
    total = start[n]
    fill = start[:n].copy()
    by_far = np.empty(total, np.int32)
    by_far_cost = np.empty(total, np.float64)
    for p in range(len(cost)):
        for a, b in ((first[p], second[p]), (second[p], first[p])):
            by_far[fill[b]] = a
            by_far_cost[fill[b]] = cost[p]
            fill[b] += 1
    fill[:] = start[:n]
    neighbour = np.empty(total, np.int32)
    value = np.empty(total, np.float64)
    for b in range(n):
        for e in range(start[b], start[b + 1]):
            a = by_far[e]
            if fill[a] > start[a] and neighbour[fill[a] - 1] == b:
                value[fill[a] - 1] += by_far_cost[e]
            else:
                neighbour[fill[a]] = b
                value[fill[a]] = by_far_cost[e]
                fill[a] += 1
    packed = np.zeros(n + 1, np.int64)
    for a in range(n):
        packed[a + 1] = packed[a] + fill[a] - start[a]
        for e in range(fill[a] - start[a]):
            neighbour[packed[a] + e] = neighbour[start[a] + e]
            value[packed[a] + e] = value[start[a] + e]
    return packed, neighbour[: packed[n]].copy(), value[: packed[n]].copy()


@compiled
def _objective(start, neighbour, cost, label, part, parts):
    total = np.zeros(parts)
    for a in range(len(start) - 1):
        for e in range(start[a], start[a + 1]):
            b = neighbour[e]
            if a < b and label[a] == label[b]:
                total[part[a]] += cost[e]
    return total


@compiled
def group_members(group_start, group):
    """CSR of the nodes in each group: start (T + 1,) and node (K,), ascending in a group."""
    groups = 0
    for t in group:
        groups = max(groups, t + 1)
    start = np.zeros(groups + 1, np.int64)
    for t in group:
        start[t + 1] += 1
    for t in range(groups):
        start[t + 1] += start[t]
    fill = start[:groups].copy()
    member = np.empty(len(group), np.int64)
    for i in range(len(group_start) - 1):
        for e in range(group_start[i], group_start[i + 1]):
            member[fill[group[e]]] = i
            fill[group[e]] += 1
    return start, member


def _entries(start: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The entries of some rows of a compressed matrix, and which of the rows each is in."""
    size = start[rows + 1] - start[rows]
    owner = np.repeat(np.arange(len(rows)), size)
    offset = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
    return start[rows][owner] + offset, owner
