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
    """Correlation clustering of nodes that carry tokens, as numpy arrays on the CPU.

        minimise  sum of cost over the pairs of nodes inside clusters
        subject to  no two nodes of a cluster share a token

    A node is one observation, whose token is its view, or several observations that stay together,
    whose tokens are all of their views. A cannot-link pair is a token that only the two carry.
    Pairs that share a token are not edges, and tokens that only one node carries are dropped:
    neither has a say.

    Args:
        start: (n + 1,) int64; the edges of node i are ``start[i]:start[i + 1]``.
        neighbour: (E,) int32 the other end. Each pair is listed from both ends, neighbours ascend.
        cost: (E,) float64, negative attracts.
        token_start: (n + 1,) int64; the tokens of node i are ``token_start[i]:token_start[i + 1]``.
        token: (K,) int32 >= 0, ascending within a node.
    """

    start: np.ndarray
    neighbour: np.ndarray
    cost: np.ndarray
    token_start: np.ndarray
    token: np.ndarray

    def __len__(self) -> int:
        """n, the number of nodes."""
        return len(self.start) - 1

    @classmethod
    def from_problem(cls, problem: Problem) -> Graph:
        """One node an observation, with its view as its token."""
        return cls.from_problems([problem])

    @classmethod
    def from_problems(cls, problems: Sequence[Problem]) -> Graph:
        """Several problems side by side; nothing connects them.

        One copy for each dtype brings all of them from a device: the moves are sequential by
        nature, and need the graph on the host. Its components are found there too: that is one pass
        over the edges, while on the device it would take several, and the host would still need
        both.
        """
        none = np.zeros((2, 0), np.int64)
        pairs, cost, incidence, nodes, tokens = [none], [np.zeros(0)], [none], 0, 0
        copies = on_host([x for p in problems for x in (p.incidence, p.pairs, p.cost)])
        for i, problem in enumerate(problems):
            (node, token), ends, value = (copy.numpy() for copy in copies[3 * i : 3 * i + 3])
            pairs.append(ends + nodes)
            cost.append(value)
            incidence.append(np.stack([node + nodes, token + tokens]))
            nodes += len(problem)
            tokens += int(token.max()) + 1 if len(token) else 0
        return cls.from_arrays(
            nodes, np.concatenate(pairs, 1), np.concatenate(cost), np.concatenate(incidence, 1)
        )

    @classmethod
    def from_arrays(cls, n: int, pairs: Any, cost: Any, tokens: Any) -> Graph:
        """From pairs of nodes and (node, token) incidences, each in any order.

        Args:
            n: Number of nodes.
            pairs: (2, P) integers; the costs of a pair that is listed twice, in either order, add.
            cost: (P,) float.
            tokens: (2, K) integers: node and token; repeated incidences count once.
        """
        token_start, token = _token_lists(n, np.asarray(tokens))
        pairs, cost = np.asarray(pairs), np.asarray(cost, np.float64)
        keep = _worth_an_edge(pairs[0], pairs[1], cost, token_start, token)
        first = pairs[0][keep].astype(np.int32)
        second = pairs[1][keep].astype(np.int32)
        start, neighbour, value = _adjacency(n, first, second, cost[keep])
        return cls(start, neighbour, value, token_start, token)

    def contract(self, label: np.ndarray) -> Graph:
        """The graph of the clusters: costs between two of them add, their tokens unite.

        Args:
            label: (n,) integers 0..k-1, each in use, feasible. The cost inside clusters is gone
                from the new graph: :meth:`objective` of the label is what it was.
        """
        label = np.asarray(label)
        first = np.repeat(np.arange(len(self), dtype=np.int32), np.diff(self.start))
        upper = first < self.neighbour
        pairs = np.stack([label[first[upper]], label[self.neighbour[upper]]])
        owner = np.repeat(label, np.diff(self.token_start))
        k = int(label.max()) + 1 if len(label) else 0
        return Graph.from_arrays(k, pairs, self.cost[upper], np.stack([owner, self.token]))

    def subgraph(self, nodes: np.ndarray) -> Graph:
        """The graph of some nodes (ascending), renumbered in their order."""
        index = np.full(len(self), -1, np.int64)
        index[nodes] = np.arange(len(nodes))
        first = np.repeat(np.arange(len(self), dtype=np.int32), np.diff(self.start))
        inside = (first < self.neighbour) & (index[first] >= 0) & (index[self.neighbour] >= 0)
        pairs = np.stack([index[first[inside]], index[self.neighbour[inside]]])
        owner = index[np.repeat(np.arange(len(self)), np.diff(self.token_start))]
        tokens = np.stack([owner, self.token])[:, owner >= 0]
        return Graph.from_arrays(len(nodes), pairs, self.cost[inside], tokens)

    def objective(self, label: np.ndarray) -> float:
        """Sum of the cost over the pairs inside clusters."""
        return float(_inside_cost(self.start, self.neighbour, self.cost, label))

    def is_feasible(self, label: np.ndarray) -> bool:
        """Whether no two nodes of a cluster share a token."""
        if not len(self.token):
            return True
        owner = np.repeat(np.asarray(label, dtype=np.int64), np.diff(self.token_start))
        key = owner * (int(self.token.max()) + 1) + self.token
        return len(np.unique(key)) == len(key)


def arrays_of(graph: Graph) -> tuple[np.ndarray, ...]:
    """start, neighbour, cost, token_start, token: what compiled kernels take."""
    return graph.start, graph.neighbour, graph.cost, graph.token_start, graph.token


def compact(label: np.ndarray) -> np.ndarray:
    """The same clusters, numbered 0.. without holes (int64)."""
    return np.unique(label, return_inverse=True)[1].astype(np.int64).reshape(-1)


def named_by_member(label: np.ndarray) -> np.ndarray:
    """The same clusters, each with its first member as label (int64)."""
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    return first.astype(np.int64)[inverse.reshape(-1)]


def _token_lists(n: int, tokens: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """CSR of the tokens that at least two nodes carry, renumbered 0.. in order."""
    if not tokens.shape[1]:
        return np.zeros(n + 1, np.int64), np.zeros(0, np.int32)
    value = np.unique(tokens[1], return_inverse=True)[1].astype(np.int64).reshape(-1)
    count = int(value.max()) + 1
    key = np.unique(tokens[0].astype(np.int64) * count + value)
    node, value = key // count, key % count
    carriers = np.bincount(value, minlength=count)
    keep = carriers[value] > 1
    node, value = node[keep], value[keep]
    renumbered = np.cumsum(carriers > 1) - 1
    start = np.zeros(n + 1, np.int64)
    np.cumsum(np.bincount(node, minlength=n), out=start[1:])
    return start, renumbered[value].astype(np.int32)


@compiled
def shares_token(token_start: np.ndarray, token: np.ndarray, a: int, b: int) -> bool:
    """Whether nodes a and b carry a token in common."""
    i, j = token_start[a], token_start[b]
    while i < token_start[a + 1] and j < token_start[b + 1]:
        if token[i] == token[j]:
            return True
        if token[i] < token[j]:
            i += 1
        else:
            j += 1
    return False


@compiled
def _worth_an_edge(first, second, cost, token_start, token):  # type: ignore[no-untyped-def]
    """Pairs of different nodes that may be together and whose cost is not 0."""
    keep = np.zeros(len(cost), np.bool_)
    for p in range(len(cost)):
        a, b = first[p], second[p]
        keep[p] = cost[p] != 0 and a != b and not shares_token(token_start, token, a, b)
    return keep


@compiled
def _adjacency(n, first, second, cost):  # type: ignore[no-untyped-def]
    """CSR with ascending neighbours and repeated pairs added up.

    Two passes of counting sort: by the far end, then, stably, by the near end.
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
def _inside_cost(start, neighbour, cost, label):  # type: ignore[no-untyped-def]
    total = 0.0
    for a in range(len(start) - 1):
        for e in range(start[a], start[a + 1]):
            b = neighbour[e]
            if a < b and label[a] == label[b]:
                total += cost[e]
    return total
