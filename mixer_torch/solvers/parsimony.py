"""Among answers of one cost, the one that claims least."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.search.decomposition import components
from mixer_torch.solvers.search.graph import Graph


def without_idle_links(graph: Graph, label: np.ndarray) -> np.ndarray:
    """Split each cluster into the parts that chains of negative-cost pairs hold together.

    No pair of negative cost lies between two such parts, so what lies between them costs 0 or more:
    without it the objective is no higher, no constraint is broken, and no two observations are
    called the same without evidence. Where nothing at all is known between two clusters (pairs
    that are not listed, or scores of 0.5), to merge them or not would else be left to chance.

    Args:
        graph: What the labels answer.
        label: (n,) any integers.

    Returns:
        (n,) int64, 0.. in order of first appearance.
    """
    return components(graph, np.asarray(label, np.int64))
