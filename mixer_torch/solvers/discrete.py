"""The discrete path: many problems as one graph, the best start of each part, refinement."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from mixer_torch.solvers.base import Problem
from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.decomposition import cut_along, decompose
from mixer_torch.solvers.graph import Graph, named_by_member
from mixer_torch.solvers.greedy import greedy
from mixer_torch.solvers.refinement import RESTARTS, Progress, refine


def solve_discrete(
    problem: Problem,
    starts: Sequence[Tensor] = (),
    *,
    restarts: int = RESTARTS,
    seed: int = 0,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> tuple[Tensor, dict[str, Any]]:
    """Labels of one problem; see :func:`solve_discrete_batch`, of which this is a batch of one."""
    return solve_discrete_batch(
        [problem],
        [starts],
        restarts=restarts,
        seed=seed,
        time_limit=time_limit,
        progress=progress,
    )[0]


def solve_discrete_batch(
    problems: Sequence[Problem],
    starts: Sequence[Sequence[Tensor]] | None = None,
    *,
    restarts: int = RESTARTS,
    seed: int = 0,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> list[tuple[Tensor, dict[str, Any]]]:
    """Labels of several problems, from the best of their starts and the greedy contraction.

    The problems are put side by side as one graph, which falls apart again into the connected
    components of negative cost (:func:`decompose`). Each of these begins from whichever start is
    best there, and is refined (:func:`refine`). A problem's labels do not depend on the others.

    Args:
        problems: Any number of any sizes.
        starts: For each problem any number of feasible labels (m,); none at all if None.
        restarts: Perturbed restarts in a row without gain after which a component is left.
        seed: Of all random draws.
        time_limit: Seconds for all of them together; None for no limit.
        progress: Told the fraction that is done.

    Returns:
        For each problem its labels (m,) int64 on its device, each cluster named by its first
        member, and stats: ``greedy``, ``starts`` (a list), ``start`` (the best of each part
        together) and ``objective`` are costs; ``parts`` counts the components; ``timed_out``;
        ``seconds`` of the whole batch.

    Raises:
        ValueError: A start has the wrong shape or breaks a constraint.
    """
    begin = time.perf_counter()
    offset = np.concatenate([[0], np.cumsum([len(problem) for problem in problems])]).astype(int)
    given = [[np.asarray(one.cpu()) for one in own] for own in starts or [()] * len(problems)]
    for own, problem in zip(given, problems, strict=True):
        for one in own:
            if one.shape != (len(problem),):
                raise ValueError(f"starts: expected shape ({len(problem)},), got {one.shape}")
    graph = Graph.from_problems(problems)
    parts = decompose(graph)
    candidates = [greedy(graph)]
    for k in range(max((len(own) for own in given), default=0)):
        candidates.append(_side_by_side([own[k : k + 1] for own in given], offset, candidates[0]))
    candidates = [cut_along(label, parts) for label in candidates]
    costs = np.stack([part_costs(graph, label, parts.part, len(parts)) for label in candidates])
    for label in candidates[1:]:
        if not graph.is_feasible(label):
            raise ValueError("starts: expected no two observations of one view in a cluster")
    choice = costs.argmin(0)[parts.part]
    start = np.stack(candidates)[choice, np.arange(len(graph))] * len(candidates) + choice
    spent = time.perf_counter() - begin
    label, stats = refine(
        graph,
        start,
        restarts=restarts,
        seed=seed,
        time_limit=None if time_limit is None else max(time_limit - spent, 0.0),
        progress=progress,
        key=np.arange(len(graph)) - np.repeat(offset[:-1], np.diff(offset)),
    )
    owner = np.zeros(len(parts), int)
    owner[parts.part] = np.repeat(np.arange(len(problems)), np.diff(offset))
    label = named_by_member(label)
    final = part_costs(graph, label, parts.part, len(parts))

    def per_problem(cost: np.ndarray) -> np.ndarray:
        return np.bincount(owner, cost, len(problems))

    table = [per_problem(row) for row in costs]
    first, last = per_problem(costs.min(0)), per_problem(final)
    count = np.bincount(owner, minlength=len(problems))
    seconds = time.perf_counter() - begin
    answers = []
    for p, problem in enumerate(problems):
        own_stats = {
            "greedy": float(table[0][p]),
            "starts": [float(row[p]) for row in table[1 : len(given[p]) + 1]],
            "start": float(first[p]),
            "objective": float(last[p]),
            "parts": int(count[p]),
            "timed_out": stats["timed_out"],
            "seconds": seconds,
        }
        own = label[offset[p] : offset[p + 1]] - offset[p]
        answers.append((torch.from_numpy(own).to(problem.view.device), own_stats))
    return answers


def _side_by_side(
    labels: Sequence[Sequence[np.ndarray]], offset: np.ndarray, otherwise: np.ndarray
) -> np.ndarray:
    """Labels of the union: those of each problem that has one, and another's where it has none."""
    joint = otherwise.copy()
    for p, own in enumerate(labels):
        if own and len(own[0]):
            _, first, inverse = np.unique(own[0], return_index=True, return_inverse=True)
            joint[offset[p] : offset[p + 1]] = first[inverse.reshape(-1)] + offset[p]
    return joint


@compiled
def _part_costs(start, neighbour, cost, label, part, parts):  # type: ignore[no-untyped-def]
    total = np.zeros(parts)
    for a in range(len(start) - 1):
        for e in range(start[a], start[a + 1]):
            b = neighbour[e]
            if a < b and label[a] == label[b]:
                total[part[a]] += cost[e]
    return total


def part_costs(graph: Graph, label: np.ndarray, part: np.ndarray, parts: int) -> np.ndarray:
    """(parts,) the cost inside clusters, part by part; each cluster lies within one."""
    return _part_costs(graph.start, graph.neighbour, graph.cost, label, part, parts)
