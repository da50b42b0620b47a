"""Discrete refinement: moves that keep every constraint, and perturbed restarts."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from mixer_torch.solvers.base import Problem
from mixer_torch.solvers.compiled import compiled, mix
from mixer_torch.solvers.decomposition import Parts, cut_along, decompose
from mixer_torch.solvers.graph import Graph, compact, named_by_member
from mixer_torch.solvers.search import search

Progress = Callable[[float], None]
CHUNK = 2_000_000  # work (nodes x restarts) between two looks at the clock


def refine(
    graph: Graph | Problem,
    labels: np.ndarray | None = None,
    *,
    restarts: int = 300,
    seed: int = 0,
    time_limit: float | None = None,
    progress: Progress | None = None,
    key: np.ndarray | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Better labels, never worse ones.

    Each part (:func:`decompose`) is descended by moves of single nodes, re-matching of one token's
    carriers, merges and exchanges until none gains; then ``restarts`` times a random region is
    taken apart, put together in random order and descended again, and the result is kept if it is
    not worse.

    Args:
        graph: The problem.
        labels: (n,) feasible start of any integers >= 0; every node alone if None.
        restarts: Perturbed restarts of each part.
        seed: Of all random draws; the same seed gives the same labels where time does not run out.
        time_limit: Seconds after which no further restart begins; None for no limit.
        progress: Told the fraction that is done.
        key: (n,) integers that stand for the nodes in the random draws. Problems that are solved
            side by side as one graph number their nodes from 0 each, so that the answer to one
            does not depend on the others.

    Returns:
        Labels (n,) int64, 0.. without holes, and stats: ``start`` and ``objective``, ``parts``,
        ``restarts`` (perturbed ones, of all parts), ``timed_out``.

    Raises:
        ValueError: The labels are malformed or break a constraint.
    """
    graph = Graph.from_problem(graph) if isinstance(graph, Problem) else graph
    n = len(graph)
    labels = np.arange(n) if labels is None else np.asarray(labels)
    if labels.shape != (n,):
        raise ValueError(f"labels: expected shape ({n},), got {labels.shape}")
    if not graph.is_feasible(labels):
        raise ValueError("labels: expected no two nodes of a cluster to share a token")
    deadline = np.inf if time_limit is None else time.perf_counter() + time_limit
    start = graph.objective(labels)
    parts = decompose(graph)
    label = named_by_member(cut_along(labels, parts))
    key = np.arange(n) if key is None else np.asarray(key, dtype=np.int64)
    timed_out = _run(graph, parts, label, restarts, seed, key, deadline, progress)
    label = compact(label)
    stats = {
        "start": start,
        "objective": graph.objective(label),
        "parts": len(parts),
        "timed_out": timed_out,
    }
    return label, stats


def _run(
    graph: Graph,
    parts: Parts,
    label: np.ndarray,
    restarts: int,
    seed: int,
    key: np.ndarray,
    deadline: float,
    progress: Progress | None,
) -> bool:
    """Search each part, in chunks of about equal work; whether time ran out."""
    random = _seeds(seed, key[parts.order[parts.start[:-1]]])
    size = np.diff(parts.start)
    work = np.cumsum(size * (restarts + 1))
    done = 0
    while done < len(parts):
        base = work[done - 1] if done else 0
        until = max(int(np.searchsorted(work, base + CHUNK, side="right")), done + 1)
        timed_out = time.perf_counter() > deadline
        rounds = int(max(1, size[done] * restarts // CHUNK)) if until == done + 1 else 1
        for _ in range(rounds):
            timed_out = time.perf_counter() > deadline
            now = 0 if timed_out else -(-restarts // rounds)
            _search_parts(
                graph.start, graph.neighbour, graph.cost, graph.token_start, graph.token,
                parts.order, parts.start, done, until, label, now, random,
            )  # fmt: skip
            if timed_out:
                break
        done = until
        if progress is not None:
            progress(float(work[done - 1] / work[-1]))
    return time.perf_counter() > deadline


def _seeds(seed: int, key: np.ndarray) -> np.ndarray:
    """(parts, 1) uint64 states of the random draws, one for each part."""
    base = np.uint64(seed % 2**64)
    return np.array([[mix(mix(base) + np.uint64(k))] for k in key], np.uint64).reshape(-1, 1)


@compiled
def _search_parts(  # type: ignore[no-untyped-def]
    start, neighbour, cost, token_start, token, order, part_start, first, last,
    label, restarts, random,
):  # fmt: skip
    n = len(start) - 1
    tokens = 0
    for t in token:
        tokens = max(tokens, t + 1)
    index = np.full(n, -1, np.int64)
    renumbered = np.full(tokens, -1, np.int64)
    slot = np.full(n + 1, -1, np.int64)
    for p in range(first, last):
        nodes = order[part_start[p] : part_start[p + 1]]
        k = len(nodes)
        if k == 1:
            continue
        for i in range(k):
            index[nodes[i]] = i
        weight = np.zeros((k, k))
        own_start = np.zeros(k + 1, np.int64)
        for i in range(k):
            a = nodes[i]
            own_start[i + 1] = own_start[i] + token_start[a + 1] - token_start[a]
            for e in range(start[a], start[a + 1]):
                j = index[neighbour[e]]
                if j >= 0:
                    weight[i, j] = cost[e]
        own = np.empty(own_start[k], np.int32)
        used = 0
        for i in range(k):
            a = nodes[i]
            for e in range(token_start[a], token_start[a + 1]):
                if renumbered[token[e]] < 0:
                    renumbered[token[e]] = used
                    used += 1
                own[own_start[i] + e - token_start[a]] = renumbered[token[e]]
        local = np.empty(k, np.int64)
        named = 0
        for i in range(k):
            c = label[nodes[i]]
            if slot[c] < 0:
                slot[c] = named
                named += 1
            local[i] = slot[c]
        for i in range(k):
            slot[label[nodes[i]]] = -1
        search(weight, own_start, own, local, restarts, random[p])
        for i in range(k):
            if slot[local[i]] < 0:
                slot[local[i]] = nodes[i]
            label[nodes[i]] = slot[local[i]]
        for i in range(k):
            slot[local[i]] = -1
            index[nodes[i]] = -1
            a = nodes[i]
            for e in range(token_start[a], token_start[a + 1]):
                renumbered[token[e]] = -1
