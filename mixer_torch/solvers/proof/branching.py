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

DECIDED = 1e-6  # x within this of 0 or 1 is; HiGHS is run at a tolerance of 1e-9
PROVEN = 1e-7  # of the largest cost: no clustering is better by more
# Set by hand; benchmarks/sensitivity.py shows what half and twice of each do to the time.
ROUNDS = 3  # of cuts that have to close a part of the gap; then slack cuts are dropped
WORTH = 0.3  # that part of the gap; the node is branched where it is not closed
ASCENT = 0.2  # of the time at most goes into dual ascent
LARGEST = 400  # nodes of a linear program, 80,000 pairs; beyond, dual ascent has all the time


class Proof(NamedTuple):
    """The best labels, a bound that is proven for all others, and what it took."""

    labels: np.ndarray
    bound: float
    proven: bool
    nodes: int
    cuts: int


@dataclass(order=True)
class _Node:
    """A subproblem of the search tree: pairs that are decided to be together, or separate.

    The one with the lowest bound comes first.
    """

    bound: float
    serial: int
    together: np.ndarray = field(compare=False)
    separate: np.ndarray = field(compare=False)


class BranchAndCut:
    """Correlation clustering of n nodes to proven optimality.

    Args:
        graph: The part.
        labels: (n,) a feasible start; the better it is the faster the proof.
        deadline: Time of ``time.perf_counter`` at which to stop.
    """

    def __init__(self, graph: Graph, labels: np.ndarray, deadline: float) -> None:
        self.graph, self.deadline = graph, deadline
        cost, self.conflict = dense(graph)
        self.scale = float(np.abs(cost).max()) or 1.0
        self.step = granularity(graph.cost) / self.scale
        self.program = PairProgram(cost / self.scale, self.conflict)
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
        """The root, with what dual ascent decides; the linear program starts with its cuts."""
        free = np.zeros(len(self.program.cost), bool)
        now = time.perf_counter()
        part = 1.0 if len(self.graph) > LARGEST else ASCENT
        deadline = now + part * (self.deadline - now)
        ascent = ascend(self._cost, self.conflict, deadline, self._enough())
        node = _Node(ascent.bound, 0, free, free)
        self._fix(node, ascent.bound, self.program.variables.vector(ascent.reduced))
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
        """Cuts until none is violated or they no longer pay, and whether x is a clustering."""
        bounds: list[float] = []
        limit = max(200, 5 * len(self.graph))  # new cuts in a round
        while True:
            self.program.limit(node.together.astype(float), (~node.separate).astype(float))
            optimum = self.program.solve(self.deadline)
            bounds.append(optimum.bound)
            if not optimum.finished or self._is_beaten(optimum.bound):
                return optimum, False
            x = self.program.variables.matrix(optimum.x)
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
            if len(bounds) % ROUNDS == 0:
                self.program.drop_slack()
            self.program.add(cuts)
            self.cuts += len(cuts)

    def _fix(self, node: _Node, bound: float, reduced: np.ndarray) -> None:
        """Decide pairs whose other value could not lead to a better clustering.

        A clustering that departs from the reduced cost's sign at a pair costs bound + |reduced|.
        """
        room = self._cutoff() - bound
        node.separate = node.separate | ((reduced > room) & ~node.together)
        node.together = node.together | ((-reduced > room) & ~node.separate)

    def _propagate(self, node: _Node) -> bool:
        """What the decided pairs imply for others; False where they contradict one another."""
        n = len(self.graph)
        first, second = self.program.variables.first, self.program.variables.second
        one = node.together
        links = coo_array((one[one], (first[one], second[one])), shape=(n, n))
        component = connected_components(links, directed=False)[1]
        conflict = self.conflict.copy()
        conflict[first[node.separate], second[node.separate]] = True
        conflict |= conflict.T
        member = np.zeros((n, component.max() + 1))
        member[np.arange(n), component] = 1
        between = member.T @ conflict @ member > 0
        if between.diagonal().any():
            return False
        node.separate = between[component[first], component[second]]
        node.together = component[first] == component[second]
        return True

    def _branch(self, node: _Node, x: np.ndarray) -> list[_Node]:
        """Two children: in one the most undecided pair is together, in the other separate."""
        undecided = np.minimum(x, 1 - x)
        pair = int(np.lexsort((-np.abs(self.program.cost), -undecided.round(6)))[0])
        children = []
        for value in (True, False):
            together, separate_ = node.together.copy(), node.separate.copy()
            (together if value else separate_)[pair] = True
            self._serial += 1
            children.append(_Node(node.bound, self._serial, together, separate_))
        return children

    def _improve(self, x: np.ndarray) -> None:
        """Round x to a clustering, refine it, and keep it if it is the best one."""
        variables, graph = self.program.variables, self.graph
        pairs = np.stack([variables.first, variables.second])
        groups = np.stack([graph.group_node, graph.group])
        rounding = Graph.from_arrays(len(x), pairs, 0.5 - variables.vector(x), groups)
        labels = refine(rounding, restarts=0)[0]
        left = max(self.deadline - time.perf_counter(), 0.0)
        labels = refine(self.graph, labels, restarts=len(x), seed=self.nodes, time_limit=left)[0]
        objective = self.graph.objective(labels) / self.scale
        if objective < self.objective:
            self.labels, self.objective = labels, objective

    def _cutoff(self) -> float:
        """A bound above this rules out better clusterings: the next lower cost is a step away."""
        return self.objective - self.step * (1 - DECIDED)

    def _is_beaten(self, bound: float) -> bool:
        return bound >= self._enough()

    def _enough(self) -> float:
        """A bound that proves the best clustering."""
        return self._cutoff() - (0.0 if self.step else PROVEN)

    def _strengthened(self, bound: float) -> float:
        """The next multiple of the step: no clustering lies between."""
        if not self.step or not np.isfinite(bound):
            return bound
        return float(np.ceil(bound / self.step - DECIDED) * self.step)


def dense(graph: Graph) -> tuple[np.ndarray, np.ndarray]:
    """(n, n) costs, and the conflict mask: which two nodes may not be together."""
    n = len(graph)
    cost = np.zeros((n, n))
    cost[graph.near, graph.neighbour] = graph.cost
    has = np.zeros((n, int(graph.group.max()) + 1 if len(graph.group) else 0))
    has[graph.group_node, graph.group] = 1
    conflict = has @ has.T > 0
    np.fill_diagonal(conflict, False)
    return cost, conflict


def granularity(cost: np.ndarray) -> float:
    """The largest number of which all costs are multiples, 0 where it is too small to be of use.

    Found for integers below 2^40 over a power of two up to 2^11, which are exact as floats, and so
    are their sums.
    """
    for power in range(12):
        scaled = cost * 2.0**power
        if np.abs(scaled).max(initial=0) < 2**40 and (scaled == np.round(scaled)).all():
            divisor = float(np.gcd.reduce(np.abs(scaled).astype(np.int64), initial=0))
            return divisor / 2.0**power if divisor else 0.0
    return 0.0
