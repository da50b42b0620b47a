"""Problems of different sizes as one padded batch of dense matrices, and its result."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.problem import Problem
from mixer_torch.solvers.search.decomposition import Parts
from mixer_torch.solvers.search.graph import Graph, share_group

# Entries of a batch's cost matrices. On a CPU, torch splits elementwise kernels of 2^15 entries and
# more among threads (its GRAIN_SIZE), which small ones only wait for; on a GPU, as many as keep the
# device busy.
ENTRIES_CPU = 2**15 - 1
ENTRIES_GPU = 2**24
# Observations of a problem up to which one thread is best, as timed on a CPU of two cores.
LARGEST_CPU = 180
SPREAD, SLACK = 0.75, 8  # sizes in a batch: at least so large a share of the largest, less some


@dataclass(frozen=True)
class Batch:
    """B problems of at most m observations, as dense matrices; the rest of each is padding.

    Args:
        cost: Ā of each problem, 0 in the padding.
        distinctness: P_d of each problem, 0 in the padding.
        mask: Which rows are observations.
    """

    cost: Float[Tensor, "B m m"]
    distinctness: Float[Tensor, "B m m"]
    mask: Bool[Tensor, "B m"]

    @classmethod
    def of(cls, problems: Sequence[Problem]) -> Batch:
        """The batch of some problems of one dtype on one device."""
        size = torch.tensor([len(problem) for problem in problems])
        m = int(size.max())
        like = problems[0].cost
        cost = like.new_zeros(len(problems), m, m)
        count = torch.tensor([problem.pairs.shape[1] for problem in problems])
        which = torch.repeat_interleave(torch.arange(len(problems)), count).to(like.device)
        a, b = torch.cat([problem.pairs for problem in problems], 1)
        value = torch.cat([problem.cost.detach() for problem in problems])
        cost[which, a, b] = value
        cost[which, b, a] = value
        mask = (torch.arange(m) < size[:, None]).to(like.device)
        return cls(cost, _distinctness(problems, mask, like), mask)

    @classmethod
    def of_parts(cls, graph: Graph, parts: Parts, chosen: Sequence[int], like: Tensor) -> Batch:
        """The batch of some parts of a graph, of the dtype and on the device of a tensor."""
        size = np.diff(parts.start)[list(chosen)]
        m, dtype = int(size.max()), str(like.dtype).removeprefix("torch.")
        cost, conflict = np.zeros((2, len(size), m, m), dtype)
        _fill(
            graph.start, graph.neighbour, graph.cost, graph.group_start, graph.group,
            parts.order, parts.start, np.array(chosen), cost, conflict,
        )  # fmt: skip
        mask = torch.arange(m) < torch.from_numpy(size)[:, None]
        arrays = torch.from_numpy(cost), torch.from_numpy(conflict), mask
        return cls(*(array.to(like.device, non_blocking=True) for array in arrays))

    def __len__(self) -> int:
        """B, the number of problems."""
        return len(self.mask)


@dataclass(frozen=True)
class Descent:
    """Where a gradient stage ended, for each problem of the batch.

    Args:
        assignment: U, 0 in the padding.
        iterations: Steps until the problem was finished.
        penalty: The last coefficient of the penalties, relative to the scale of the costs.
        history: Relaxed objective at each iteration.
    """

    assignment: Float[Tensor, "B m k"]
    iterations: Int64[Tensor, " B"]
    penalty: Float[Tensor, " B"]
    history: Float[Tensor, "T B"]


def continued(first: Descent, chosen: Int64[Tensor, " C"], then: Descent) -> Descent:
    """A descent that some problems of its batch went on with; the others keep what they had."""
    assignment = first.assignment.clone()
    assignment[chosen] = then.assignment
    iterations, penalty = first.iterations.clone(), first.penalty.clone()
    iterations[chosen] += then.iterations
    penalty[chosen] = then.penalty
    more = first.history[-1:].repeat(len(then.history), 1)
    more[:, chosen] = then.history
    return Descent(assignment, iterations, penalty, torch.cat([first.history, more]))


def buckets(sizes: Sequence[int], device: torch.device) -> Iterator[list[int]]:
    """Indices of problems that go well into one batch: alike in size, and not too many.

    Sizes within a bucket differ by at most a quarter (and 8), so that little of the work is spent
    on padding; its matrices are no larger than suits the device, unless it holds one problem.
    """
    entries = ENTRIES_CPU if device.type == "cpu" else ENTRIES_GPU
    bucket: list[int] = []
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i]):
        if bucket:
            largest = sizes[bucket[0]]
            full = (len(bucket) + 1) * largest**2 > entries
            if full or sizes[i] < SPREAD * largest - SLACK:
                yield bucket
                bucket = []
        bucket.append(i)
    if bucket:
        yield bucket


def _distinctness(problems: Sequence[Problem], mask: Tensor, like: Tensor) -> Tensor:
    m = mask.shape[1]
    if all(problem.groups is None for problem in problems):
        view = torch.full(mask.shape, -1, device=like.device)
        view[mask] = torch.cat([problem.view for problem in problems])
        conflict = (view[:, :, None] == view[:, None, :]) & mask[:, :, None]
        conflict.diagonal(dim1=1, dim2=2).fill_(False)
        return conflict.to(like.dtype)
    conflict = like.new_zeros(len(problems), m, m)
    for matrix, problem in zip(conflict, problems, strict=True):
        matrix[: len(problem), : len(problem)] = problem.conflicts()
    return conflict


@compiled
def _fill(  # type: ignore[no-untyped-def]
    start, neighbour, cost, group_start, group, order, part_start, chosen, dense, conflict
):
    index = np.full(len(start) - 1, -1, np.int64)
    for b in range(len(chosen)):
        nodes = order[part_start[chosen[b]] : part_start[chosen[b] + 1]]
        for i in range(len(nodes)):
            index[nodes[i]] = i
        for i in range(len(nodes)):
            a = nodes[i]
            for e in range(start[a], start[a + 1]):
                if index[neighbour[e]] >= 0:
                    dense[b, i, index[neighbour[e]]] = cost[e]
            for j in range(i):
                if share_group(group_start, group, a, nodes[j]):
                    conflict[b, i, j] = conflict[b, j, i] = 1
        for a in nodes:
            index[a] = -1
