"""Discrete refinement: moves that keep every constraint, and perturbed restarts."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from mixer_torch.solvers.base import Problem
from mixer_torch.solvers.compiled import compiled, mix
from mixer_torch.solvers.decomposition import Parts, cut_along, decompose
from mixer_torch.solvers.graph import Graph, arrays_of, compact, named_by_member
from mixer_torch.solvers.multilevel import refine_large
from mixer_torch.solvers.region import carriers_of, named, search_region

Progress = Callable[[float], None]
RESTARTS = 150  # of each part
CHUNK = 100_000  # work (nodes x restarts) between two looks at the clock
DENSE = 1000  # nodes up to which a part is held as a matrix
LARGE_SHARE = 10  # a region of a large part gets this fraction of the restarts


class Effort(NamedTuple):
    """How hard to search: restarts, seed, deadline by ``time.perf_counter()``, progress."""

    restarts: int
    seed: int
    deadline: float
    progress: Progress | None


def refine(
    graph: Graph | Problem,
    labels: np.ndarray | None = None,
    *,
    restarts: int = RESTARTS,
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
    effort = Effort(restarts, seed, deadline, progress)
    timed_out = _run(graph, parts, label, effort, key)
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
    effort: Effort,
    key: np.ndarray,
) -> bool:
    """Search all parts, small ones many at a time, and write the labels; whether time ran out."""
    random = _seeds(effort.seed, key[parts.order[parts.start[:-1]]])
    size = np.diff(parts.start)
    work = np.cumsum(np.where(size > 1, size, 0) * (effort.restarts + 1))
    arrays, carrier, names = arrays_of(graph), carriers_of(graph), named(graph, label)
    done = 0
    while done < len(parts):
        base = work[done - 1] if done else 0
        until = max(int(np.searchsorted(work, base + CHUNK, side="right")), done + 1)
        large = np.flatnonzero(size[done:until] > DENSE)
        if len(large) and large[0] == 0:
            until = done + 1
            _search_large(graph, parts, done, label, effort, random[done])
            names = named(graph, label)
        else:
            until = done + int(large[0]) if len(large) else until
            rounds = max(1, int(size[done]) * effort.restarts // CHUNK) if until == done + 1 else 1
            for count in _shares(effort.restarts, rounds):
                now = 0 if time.perf_counter() > effort.deadline else count
                for part in range(done, until):
                    if size[part] > 1:
                        nodes = parts.order[parts.start[part] : parts.start[part + 1]]
                        search_region(arrays, carrier, names, nodes, now, random[part])
                if now < count:
                    break
        done = until
        if effort.progress is not None:
            effort.progress(float(work[done - 1] / max(work[-1], 1)))
    return time.perf_counter() > effort.deadline


def _search_large(
    graph: Graph, parts: Parts, part: int, label: np.ndarray, effort: Effort, random: np.ndarray
) -> None:
    nodes = parts.order[parts.start[part] : parts.start[part + 1]]
    own = graph if len(nodes) == len(graph) else graph.subgraph(nodes)
    restarts = -(-effort.restarts // LARGE_SHARE)
    local = refine_large(own, compact(label[nodes]), restarts, random, effort.deadline)
    label[nodes] = nodes[named_by_member(local)]


def _shares(total: int, rounds: int) -> list[int]:
    """About equal integers that sum to the total."""
    edges = [total * i // rounds for i in range(rounds + 1)]
    return [after - before for before, after in pairwise(edges)]


def _seeds(seed: int, key: np.ndarray) -> np.ndarray:
    """(parts, 1) uint64 states of the random draws, one for each part."""
    return _hashed(np.uint64(seed % 2**64), key).reshape(-1, 1)


@compiled
def _hashed(seed, key):  # type: ignore[no-untyped-def]
    state = np.empty(len(key), np.uint64)
    for p in range(len(key)):
        state[p] = mix(mix(seed) + np.uint64(key[p]))
    return state
