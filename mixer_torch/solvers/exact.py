"""The integer program, to proven optimality."""

from __future__ import annotations

import time

import numpy as np
import torch

from mixer_torch.association import Status
from mixer_torch.solvers.bounds import BLOCK, bound_of_parts
from mixer_torch.solvers.mixer import Mixer
from mixer_torch.solvers.parsimony import without_idle_links
from mixer_torch.solvers.problem import Problem, Solution, Solver
from mixer_torch.solvers.proof.branching import PROVEN, BranchAndCut, Proof
from mixer_torch.solvers.search.decomposition import cut_along, decompose
from mixer_torch.solvers.search.graph import Graph

SHORTEST = 1e-3  # seconds for the start, where the time limit is none


class Exact(Solver):
    """The integer program over pairs, by branch and cut with HiGHS: the paper's MIXER*.

        minimise  sum cost_ab x_ab   subject to  x_ab in {0, 1},  x_ab = 0 within a view,
                  x_ab + x_bc - x_ac <= 1 for all a, b, c

    Each connected component of the negative costs is solved apart. Of the inequalities, and of
    stronger ones (:class:`~mixer_torch.solvers.proof.cuts.Cuts`), only those are added that the
    linear relaxation breaks; reduced costs against the best known clustering decide most pairs;
    what is left is branched on, lowest bound first.

    A part of more than 1000 nodes has too many pairs for a program over them. It keeps the answer
    that it starts with, and is bounded block by block, as
    :func:`~mixer_torch.solvers.bounds.lower_bound` bounds it.

    Args:
        time_limit: Seconds after which the best clustering comes back with status ``TIME_LIMIT``
            and the bound proven so far.
        start: Solver whose answer the search starts from; if None ``Mixer()``, which has half of
            the time at most.

    Optimal means: no clustering is better by more than 1e-7 of the largest cost.
    """

    takes_groups = True

    def __init__(self, time_limit: float = 60.0, start: Solver | None = None) -> None:
        if not time_limit >= 0:
            raise ValueError(f"time_limit: expected seconds >= 0, got {time_limit}")
        self.time_limit = time_limit
        self.start = start

    def run(self, problem: Problem) -> Solution:
        deadline = time.perf_counter() + self.time_limit
        graph = Graph.from_problem(problem)
        parts = decompose(graph)
        labels = cut_along(self._warm_start(problem), parts)
        begin = graph.objective(labels)
        proofs = []
        for p in np.argsort(np.diff(parts.start), kind="stable"):
            members = parts.order[parts.start[p] : parts.start[p + 1]]
            part = graph.subgraph(members)
            proof = prove(part, labels[members], deadline)
            labels[members] = len(labels) * (1 + p) + proof.labels
            proofs.append(proof)
        bound = min(sum(proof.bound for proof in proofs), graph.objective(labels))
        proven = all(proof.proven for proof in proofs)
        stats = {
            "start": begin,
            "parts": len(parts),
            "nodes": sum(proof.nodes for proof in proofs),
            "cuts": sum(proof.cuts for proof in proofs),
        }
        found = torch.from_numpy(without_idle_links(graph, labels))
        return Solution(
            Status.OPTIMAL if proven else Status.TIME_LIMIT,
            labels=found.to(problem.view.device),
            lower_bound=bound,
            stats=stats,
        )

    def _warm_start(self, problem: Problem) -> np.ndarray:
        limit = max(self.time_limit / 2, SHORTEST)
        start = Mixer(time_limit=limit) if self.start is None else self.start
        alone = np.arange(len(problem))
        if problem.groups is not None and not start.takes_groups:
            return alone
        labels = start.run(problem).labels
        return alone if labels is None else labels.cpu().numpy()


def prove(part: Graph, labels: np.ndarray, deadline: float) -> Proof:
    """The best labels of one part and a bound: by branch and cut, where it is not too large."""
    if len(part) <= BLOCK:
        return BranchAndCut(part, labels, deadline).run()
    objective, bound = part.objective(labels), bound_of_parts([part], deadline)
    proven = bound >= objective - PROVEN * float(np.abs(part.cost).max())
    return Proof(labels, min(bound, objective), proven, nodes=0, cuts=0)
