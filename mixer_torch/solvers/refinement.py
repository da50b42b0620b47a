"""Discrete refinement: moves that keep every constraint, and perturbed restarts."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import compiled, mix
from mixer_torch.solvers.problem import Problem
from mixer_torch.solvers.search.decomposition import Parts, cut_along, decompose
from mixer_torch.solvers.search.exhaustive import LARGEST as ENUMERABLE
from mixer_torch.solvers.search.exhaustive import enumerate_parts
from mixer_torch.solvers.search.graph import Graph, arrays_of, compact, named_by_member
from mixer_torch.solvers.search.iterated_local_search import (
    EXHAUSTIVE,
    GAINS,
    STATE_SIZE,
    new_search_state,
)
from mixer_torch.solvers.search.iterated_local_search import RESTARTS as RUN
from mixer_torch.solvers.search.multilevel import refine_large
from mixer_torch.solvers.search.subproblem import Labelling, search_subproblem

Progress = Callable[[float], None]
# Most restarts of a part, how many nodes the smallest and the largest parts have that get all of
# them, and the fraction that a large part gets. They trade answers for time, and were set by hand;
# with the fraction, answers of m = 1,500 and 3,000 were 7 to 9 % lower than without.
RESTARTS = 400
FULL = 100, 250
LEAST = 0.075
CHUNK = 2000  # nodes x restarts between two looks at the clock: some milliseconds
# A part of more than DENSE nodes is held as a matrix only where FILLED or more of the entries are
# listed. Such parts were searched twice to ten times as fast as a matrix as by subproblems, and
# ended lower.
DENSE = 1000
FILLED = 0.25
LARGE_SHARE = 30  # a subproblem of a larger part gets one in so many restarts; set by hand


class Effort(NamedTuple):
    """How hard to search.

    Args:
        restarts: Most perturbed restarts of a part.
        seed: Of all random draws.
        deadline: By ``time.perf_counter()``, after which no restart begins.
        progress: Told the fraction that is done.
    """

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
) -> tuple[np.ndarray, dict[str, Any]]:
    """Better labels, never worse ones.

    Each part (:func:`decompose`) of a few nodes is solved by enumeration (:func:`enumerate_parts`).
    Any other is searched by iterated local search (:func:`search`), for at most ``restarts``. Parts
    too large for a matrix go to :func:`refine_large`.

    Args:
        graph: The problem.
        labels: (n,) feasible start of any integers >= 0; every node alone if None.
        restarts: Most perturbed restarts of a part; see :func:`restarts_of`.
        seed: Of all random draws; the same seed gives the same labels where time does not run out.
        time_limit: Seconds after which no further restart begins; None for no limit.
        progress: Told the fraction that is done.

    Returns:
        Labels (n,) int64, 0.. without holes, and stats: the costs ``start`` and ``objective``,
        ``parts`` (their number), ``timed_out``, and what :func:`summary` tells.

    Raises:
        ValueError: The labels are malformed or break a constraint.
    """
    graph = Graph.from_problem(graph) if isinstance(graph, Problem) else graph
    n = len(graph)
    labels = np.arange(n) if labels is None else np.asarray(labels)
    if labels.shape != (n,):
        raise ValueError(f"labels: expected shape ({n},), got {labels.shape}")
    if not graph.is_feasible(labels):
        raise ValueError("labels: expected no two nodes of a cluster to share a cannot-link group")
    deadline = np.inf if time_limit is None else time.perf_counter() + time_limit
    parts = decompose(graph)
    effort = Effort(restarts, seed, deadline, progress)
    label, states, timed_out = refine_parts(graph, parts, labels, effort, np.arange(n))
    stats = {
        "start": graph.objective(labels),
        "objective": graph.objective(label),
        "parts": len(parts),
        "timed_out": timed_out,
    }
    return label, stats | summary(states.sum(0))


def summary(state: np.ndarray) -> dict[str, Any]:
    """What the state of a search says of it.

    ``restarts``: how many ran; ``gained``: what each kind of move has lowered the cost by.
    """
    gained = {name: -float(state[at]) for name, at in GAINS.items()}
    return {"restarts": int(state[RUN]), "gained": gained}


def refine_parts(
    graph: Graph, parts: Parts, labels: np.ndarray, effort: Effort, key: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Search all parts one after the other; see :func:`refine`.

    Args:
        graph: The problem.
        parts: Its parts.
        labels: (n,) feasible start.
        effort: How hard to search.
        key: (n,) integers that stand for the nodes in the random draws. Problems that are solved
            side by side as one graph number their nodes from 0 each, so that the answer to one
            does not depend on the others.

    Returns:
        Labels (n,) int64, 0.. without holes, which are not worse; (parts, STATE_SIZE) the state of
        the search of each part; and whether time ran out.
    """
    random = _seeds(effort.seed, key[parts.order[parts.start[:-1]]])
    label = named_by_member(cut_along(labels, parts))
    size = np.diff(parts.start)
    states = np.zeros((len(parts), STATE_SIZE))
    states[:, EXHAUSTIVE] = enumerate_parts(graph, parts, label)
    arrays, members, labelling = arrays_of(graph), graph.members(), Labelling.of(graph, label)
    work, reported = np.cumsum(np.where(size > ENUMERABLE, size, 0)), 0
    for part in np.flatnonzero(size > ENUMERABLE):
        nodes = parts.order[parts.start[part] : parts.start[part + 1]]
        if size[part] > DENSE and not _is_filled(graph, nodes):
            states[part] += _search_large(graph, nodes, label, effort, random[part])
            labelling = Labelling.of(graph, label)
        else:
            states[part] += _search_small(arrays, members, labelling, nodes, effort, random[part])
        if effort.progress is not None and work[part] - reported > CHUNK:
            reported = int(work[part])
            effort.progress(reported / int(work[-1]))
    if graph.objective(label) > graph.objective(labels):  # by rounding, where nothing was gained
        label = labels
    return compact(label), states, time.perf_counter() > effort.deadline


def _is_filled(graph: Graph, nodes: np.ndarray) -> bool:
    """Whether the lists of pairs are about as large as a matrix would be."""
    listed = (graph.start[nodes + 1] - graph.start[nodes]).sum()
    return bool(listed >= FILLED * len(nodes) ** 2)


def _search_small(
    arrays: tuple[np.ndarray, ...],
    members: tuple[np.ndarray, np.ndarray],
    labelling: Labelling,
    nodes: np.ndarray,
    effort: Effort,
    random: np.ndarray,
) -> np.ndarray:
    """Search one part, and look at the clock now and then; returns the state of the search."""
    most = restarts_of(len(nodes), effort.restarts)
    state, confirmed = new_search_state(effort.restarts), np.zeros(len(nodes))
    limit, ended = 0, False
    while not ended and limit < most:
        late = time.perf_counter() > effort.deadline
        limit = limit if late else min(most, limit + max(1, CHUNK // len(nodes)))
        ended = search_subproblem(
            arrays, members, labelling, nodes, limit, state, confirmed, random
        )
        ended = ended or late
    if most == 0:
        search_subproblem(arrays, members, labelling, nodes, 0, state, confirmed, random)
    return state


def restarts_of(size: int, restarts: int) -> int:
    """Most restarts of a part: small ones need few, and in large ones each takes long."""
    smallest, largest = FULL
    return math.ceil(restarts * min(1.0, size / smallest, max((largest / size) ** 2, LEAST)))


def _search_large(
    graph: Graph, nodes: np.ndarray, label: np.ndarray, effort: Effort, random: np.ndarray
) -> np.ndarray:
    own = graph if len(nodes) == len(graph) else graph.subgraph(nodes)
    restarts = -(-effort.restarts // LARGE_SHARE)
    local, state = refine_large(
        own, compact(label[nodes]), restarts, random, effort.deadline, effort.progress
    )
    label[nodes] = nodes[named_by_member(local)]
    return state


def _seeds(seed: int, key: np.ndarray) -> np.ndarray:
    """(parts, 1) uint64 states of the random draws, one for each part."""
    return _hashed(np.uint64(seed % 2**64), key).reshape(-1, 1)


@compiled
def _hashed(seed, key):  # type: ignore[no-untyped-def]
    state = np.empty(len(key), np.uint64)
    for p in range(len(key)):
        state[p] = mix(mix(seed) + np.uint64(key[p]))
    return state
