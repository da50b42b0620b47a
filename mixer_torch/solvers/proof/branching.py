"""Branch and cut on one part of a problem: the optimum, or the best answer and a bound in time."""

from __future__ import annotations

import heapq
import time
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mixer_torch.solvers.proof.cuts import separate
from mixer_torch.solvers.proof.dual_ascent import ascend
from mixer_torch.solvers.proof.pair_program import Optimum, PairProgram
from mixer_torch.solvers.refinement import refine
from mixer_torch.solvers.search.graph import Graph, compact

DECIDED = 1e-6
PROVEN = 1e-7  # of the largest cost: what is not better by more is not better
ROUNDS = 3  # over which a round of cuts has to close a part of the gap, or the node is branched
WORTH = 0.3
ASCENT = 0.2  # of the time at most goes into dual ascent
LARGEST = 400  # nodes that a linear program is tried on; beyond, dual ascent has all the time


class Proof(NamedTuple):
    """The best labels, a bound that is proven for all others, and what it took."""

    labels: np.ndarray
    bound: float
    proven: bool
    nodes: int
    cuts: int


@dataclass(order=True)
class _Node:
    """A part of the search: pairs that are together, and pairs that are not, by decision.

    The one with the lowest bound comes first.
    """

    bound: float
    serial: int
    together: np.ndarray = field(compare=False)
    apart: np.ndarray = field(compare=False)


class BranchAndCut:
    """Correlation clustering of n nodes to proven optimality.

    Args:
        graph: The part.
        labels: (n,) a feasible start; the better it is the faster the proof.
        deadline: Time of ``time.perf_counter`` at which to stop.
    """

    def __init__(self, graph: Graph, labels: np.ndarray, deadline: float) -> None:
        self.graph, self.deadline = graph, deadline
        cost, self.apart = dense(graph)
        self.scale = float(np.abs(cost).max()) or 1.0
        self.step = granularity(graph.cost) / self.scale
        self.program = PairProgram(cost / self.scale, self.apart)
        self.labels, self.objective = compact(labels), graph.objective(labels) / self.scale
        self.nodes = self.cuts = self._serial = 0
        self._cost = cost / self.scale

    def run(self) -> Proof:
        """Search until nothing is left that could be better, or time runs out."""
        root = self._root()
        waiting = [root]
        closed = np.inf
        while waiting and time.perf_counter() < self.deadline:
            if len(self.graph) > LARGEST or self._is_beaten(waiting[0].bound):
                break
            node = heapq.heappop(waiting)
            self.nodes += 1
            children, bound = self._explore(node)
            closed = min(closed, bound)
            for child in children:
                heapq.heappush(waiting, child)
        bound = self._strengthened(min([closed, *(node.bound for node in waiting)]))
        proven = self._is_beaten(bound)
        bound = min(bound * self.scale, self.graph.objective(self.labels))
        return Proof(self.labels, bound, proven, self.nodes, self.cuts)

    def _root(self) -> _Node:
        """Nothing decided but what dual ascent decides, which is fast; its cuts are kept."""
        free = np.zeros(len(self.program.cost), bool)
        now = time.perf_counter()
        part = 1.0 if len(self.graph) > LARGEST else ASCENT
        deadline = now + part * (self.deadline - now)
        ascent = ascend(self._cost, self.apart, deadline, self._enough())
        node = _Node(ascent.bound, 0, free, free)
        reduced = ascent.reduced[self.program.first, self.program.second]
        self._fix(node, ascent.bound, reduced)
        self.program.add(ascent.cuts)
        self.cuts += len(ascent.cuts)
        return node

    def _explore(self, node: _Node) -> tuple[list[_Node], float]:
        """The children of a node and inf, or none and the bound at which the node is closed."""
        if not self._propagate(node):
            return [], np.inf
        optimum, is_clustering = self._cut(node)
        node.bound = max(node.bound, optimum.bound)
        if is_clustering or not optimum.finished or self._is_beaten(node.bound):
            return [], node.bound
        return self._branch(node, optimum.x), np.inf

    def _cut(self, node: _Node) -> tuple[Optimum, bool]:
        """Cuts until none is broken or they no longer pay, and whether x is a clustering."""
        bounds: list[float] = []
        limit = max(200, 5 * len(self.graph))
        while True:
            self.program.limit(node.together.astype(float), (~node.apart).astype(float))
            optimum = self.program.solve(self.deadline)
            bounds.append(optimum.bound)
            if not optimum.finished or self._is_beaten(optimum.bound):
                return optimum, False
            x = self.program.matrix(optimum.x)
            cuts = separate(x, DECIDED, limit)
            whole = bool((np.minimum(optimum.x, 1 - optimum.x) < DECIDED).all())
            if whole or len(bounds) == 1:
                self._improve(x)
            if not len(cuts):
                self._improve(x)
                return optimum, whole
            self._fix(node, optimum.bound, optimum.reduced)
            gap = self.objective - optimum.bound
            if len(bounds) > ROUNDS and not whole:
                gained = optimum.bound - bounds[-1 - ROUNDS]
                if gained < WORTH * gap:
                    self._improve(x)
                    return optimum, False
            if len(bounds) % 3 == 0:
                self.program.drop_slack()
            self.program.add(cuts)
            self.cuts += len(cuts)

    def _fix(self, node: _Node, bound: float, reduced: np.ndarray) -> None:
        """Decide pairs whose other value could not lead to a better clustering.

        A clustering that departs from the reduced cost's sign at a pair costs bound + |reduced|.
        """
        room = self._cutoff() - bound
        node.apart = node.apart | ((reduced > room) & ~node.together)
        node.together = node.together | ((-reduced > room) & ~node.apart)

    def _propagate(self, node: _Node) -> bool:
        """What the decided pairs imply for others; False where they contradict one another."""
        n = len(self.graph)
        first, second = self.program.first, self.program.second
        one = node.together
        links = coo_array((one[one], (first[one], second[one])), shape=(n, n))
        group = connected_components(links, directed=False)[1]
        apart = self.apart.copy()
        apart[first[node.apart], second[node.apart]] = True
        apart |= apart.T
        member = np.zeros((n, group.max() + 1))
        member[np.arange(n), group] = 1
        between = member.T @ apart @ member > 0
        if between.diagonal().any():
            return False
        node.apart = between[group[first], group[second]]
        node.together = group[first] == group[second]
        return True

    def _branch(self, node: _Node, x: np.ndarray) -> list[_Node]:
        """Two children: the most undecided pair is together, and it is not."""
        undecided = np.minimum(x, 1 - x)
        pair = int(np.lexsort((-np.abs(self.program.cost), -undecided.round(6)))[0])
        children = []
        for value in (True, False):
            together, apart = node.together.copy(), node.apart.copy()
            (together if value else apart)[pair] = True
            self._serial += 1
            children.append(_Node(node.bound, self._serial, together, apart))
        return children

    def _improve(self, x: np.ndarray) -> None:
        """Round x to a clustering, refine it, and keep it if it is the best one."""
        index = np.stack([self.program.first, self.program.second])
        tokens = np.stack(
            [
                np.repeat(np.arange(len(self.graph)), np.diff(self.graph.token_start)),
                self.graph.token,
            ]
        )
        rounding = Graph.from_arrays(len(x), index, 0.5 - x[index[0], index[1]], tokens)
        labels = refine(rounding, restarts=0)[0]
        left = max(self.deadline - time.perf_counter(), 0.0)
        labels = refine(self.graph, labels, restarts=len(x), seed=self.nodes, time_limit=left)[0]
        objective = self.graph.objective(labels) / self.scale
        if objective < self.objective:
            self.labels, self.objective = labels, objective

    def _cutoff(self) -> float:
        """A clustering above this is not better than the best one."""
        return self.objective - self.step * (1 - DECIDED)

    def _is_beaten(self, bound: float) -> bool:
        return bound >= self._enough()

    def _enough(self) -> float:
        """A bound with which the best clustering is proven."""
        return self._cutoff() - (0.0 if self.step else PROVEN)

    def _strengthened(self, bound: float) -> float:
        """The next multiple of the step: no clustering lies between."""
        if not self.step or not np.isfinite(bound):
            return bound
        return float(np.ceil(bound / self.step - DECIDED) * self.step)


def dense(graph: Graph) -> tuple[np.ndarray, np.ndarray]:
    """(n, n) costs, and which two nodes may not be together."""
    n = len(graph)
    cost = np.zeros((n, n))
    cost[np.repeat(np.arange(n), np.diff(graph.start)), graph.neighbour] = graph.cost
    node = np.repeat(np.arange(n), np.diff(graph.token_start))
    has = np.zeros((n, int(graph.token.max()) + 1 if len(graph.token) else 0))
    has[node, graph.token] = 1
    apart = has @ has.T > 0
    np.fill_diagonal(apart, False)
    return cost, apart


def granularity(cost: np.ndarray) -> float:
    """The largest number of which all costs are multiples, 0 where it is too small to be of use.

    Found for costs that are integers over a power of two, which are exact as floats.
    """
    for power in range(12):
        scaled = cost * 2.0**power
        if np.abs(scaled).max(initial=0) < 2**40 and (scaled == np.round(scaled)).all():
            divisor = float(np.gcd.reduce(np.abs(scaled).astype(np.int64), initial=0))
            return divisor / 2.0**power if divisor else 0.0
    return 0.0
