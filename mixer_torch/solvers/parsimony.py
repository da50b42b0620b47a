"""Among answers of one cost, the one that claims least."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Int64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from mixer_torch.solvers.base import Problem


def without_idle_links(problem: Problem, labels: Int64[Tensor, " m"]) -> Int64[Tensor, " m"]:
    """Split each cluster into the parts that chains of negative-cost pairs hold together.

    No pair of negative cost lies between two such parts, so what lies between them costs 0 or more:
    without it the objective is no higher, no constraint is broken, and no two observations are
    called the same without evidence. Where nothing at all is known between two clusters (pairs
    that are not listed, or scores of 0.5), to merge them or not would else be left to chance.

    Args:
        problem: What the labels answer.
        labels: (m,) any integers.
    """
    a, b = problem.pairs
    held = (labels[a] == labels[b]) & (problem.cost < 0)
    ends = problem.pairs[:, held].cpu().numpy()
    m = len(problem)
    graph = coo_array((np.ones(ends.shape[1], dtype=np.int8), (ends[0], ends[1])), shape=(m, m))
    parts = connected_components(graph, directed=False)[1]
    return torch.from_numpy(parts.astype(np.int64)).to(labels.device)
