"""How good an association is, against the truth and in itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Int64
from scipy.sparse import coo_array
from torch import Tensor

from mixer_torch.association import Association
from mixer_torch.pairs import within_view


def evaluate(association: Association, identity: Tensor, view: Tensor) -> dict[str, Any]:
    """All metrics of one association.

    An observation of identity -1 is clutter: it is the same as nothing, so a link to it is wrong.
    Two observations of one view are never counted as a pair, even if their identity is the same.

    Args:
        association: Labels, or links where it has no labels.
        identity: (m,) int64 truth, -1 where there is none.
        view: (m,) int64, the set of each observation; negative for none.

    Returns:
        ``precision``, ``recall``, ``f1`` over pairs (the paper's), ``true_pairs`` and
        ``declared_pairs``; with labels also ``bcubed_precision``, ``bcubed_recall``,
        ``bcubed_f1``, ``adjusted_rand``, ``clusters``, and ``objects``, the true number of
        clusters, each clutter observation counted as one; and those of :func:`consistency`.

    Raises:
        ValueError: The numbers of observations differ.
    """
    m = len(view)
    if len(identity) != m or (association.labels is not None and len(association.labels) != m):
        labelled = m if association.labels is None else len(association.labels)
        raise ValueError(
            f"identity, view, labels: expected one length, got {len(identity)}, {m}, {labelled}"
        )
    identity = identity.to(view.device)
    if association.labels is None:
        metrics = pairwise_of_links(association.links, identity, view)
        return metrics | consistency(association.links, view)
    labels = association.labels.to(view.device)
    truth = singletons_for_clutter(identity)
    metrics = pairwise(labels, identity, view)
    metrics |= bcubed(labels, truth) | {"adjusted_rand": adjusted_rand(labels, truth)}
    metrics |= {"clusters": len(torch.unique(labels)), "objects": len(torch.unique(truth))}
    return metrics | {"within_view_links": _pairs_within(labels, view), "open_cycles": 0}


def pairwise(
    labels: Int64[Tensor, " m"], identity: Int64[Tensor, " m"], view: Int64[Tensor, " m"]
) -> dict[str, Any]:
    """Precision, recall and F1 over pairs across views, without listing the pairs."""
    truth = singletons_for_clutter(identity)
    both = _joint(labels, truth)
    correct = _pairs(both) - _pairs_within(both, view)
    declared = _pairs(labels) - _pairs_within(labels, view)
    true = _pairs(truth) - _pairs_within(truth, view)
    return _precision_recall(correct, declared, true)


def pairwise_of_links(
    links: Int64[Tensor, "2 Q"], identity: Int64[Tensor, " m"], view: Int64[Tensor, " m"]
) -> dict[str, Any]:
    """:func:`pairwise` for links that need not be consistent."""
    links = links[:, ~within_view(view, links)]
    truth = singletons_for_clutter(identity)
    correct = int((truth[links[0]] == truth[links[1]]).sum())
    true = _pairs(truth) - _pairs_within(truth, view)
    return _precision_recall(correct, links.shape[1], true)


def bcubed(labels: Int64[Tensor, " m"], truth: Int64[Tensor, " m"]) -> dict[str, float]:
    """B-cubed precision, recall and F1 (Bagga and Baldwin 1998), each observation counted once."""
    if not len(labels):
        return {"bcubed_precision": 1.0, "bcubed_recall": 1.0, "bcubed_f1": 1.0}
    both = _size_of_own(_joint(labels, truth)).double()
    precision = float((both / _size_of_own(labels)).mean())
    recall = float((both / _size_of_own(truth)).mean())
    f1 = 2 * precision * recall / (precision + recall)
    return {"bcubed_precision": precision, "bcubed_recall": recall, "bcubed_f1": f1}


def adjusted_rand(labels: Int64[Tensor, " m"], truth: Int64[Tensor, " m"]) -> float:
    """Rand index corrected for chance (Hubert and Arabie 1985): 1 perfect, 0 as good as random."""
    total = len(labels) * (len(labels) - 1) / 2
    together, declared, true = _pairs(_joint(labels, truth)), _pairs(labels), _pairs(truth)
    expected = declared * true / total if total else 0.0
    best = (declared + true) / 2
    return 1.0 if best == expected else (together - expected) / (best - expected)


def consistency(links: Int64[Tensor, "2 Q"], view: Int64[Tensor, " m"]) -> dict[str, int]:
    """How far links are from being consistent.

    Returns:
        ``within_view_links``: links between two observations of one view, which are distinct;
        ``open_cycles``: triples with a ~ b and b ~ c but not a ~ c.
    """
    m = len(view)
    ends = links.cpu().numpy()
    ones = np.ones(ends.shape[1], dtype=np.int64)
    half = coo_array((ones, (ends[0], ends[1])), shape=(m, m)).tocsr()
    half.data[:] = 1
    graph = half + half.T
    degree = np.asarray(graph.sum(1)).ravel()
    paths = int((degree * (degree - 1) // 2).sum())
    triangles = int(((graph @ graph) * graph).sum()) // 6
    return {
        "within_view_links": int(within_view(view, links).sum()),
        "open_cycles": paths - 3 * triangles,
    }


def singletons_for_clutter(identity: Int64[Tensor, " m"]) -> Int64[Tensor, " m"]:
    """The truth with an identity of its own for each observation that has none."""
    clutter = identity < 0
    start = int(identity.max()) + 1 if len(identity) else 0
    return torch.where(clutter, max(start, 0) + torch.cumsum(clutter, 0), identity)


def _precision_recall(correct: int, declared: int, true: int) -> dict[str, Any]:
    precision = correct / declared if declared else 1.0
    recall = correct / true if true else 1.0
    f1 = 2 * correct / (declared + true) if declared + true else 1.0
    return {
        "precision": precision,
        "recall": recall,
        "f1": f1,
        "declared_pairs": declared,
        "true_pairs": true,
    }


def _joint(a: Int64[Tensor, " m"], b: Int64[Tensor, " m"]) -> Int64[Tensor, " m"]:
    return torch.unique(torch.stack([a, b]), dim=1, return_inverse=True)[1].reshape(len(a))


def _pairs(labels: Int64[Tensor, " m"]) -> int:
    size = torch.unique(labels, return_counts=True)[1]
    return int((size * (size - 1) // 2).sum())


def _pairs_within(labels: Int64[Tensor, " m"], view: Int64[Tensor, " m"]) -> int:
    has_view = view >= 0
    return _pairs(_joint(labels[has_view], view[has_view]))


def _size_of_own(labels: Int64[Tensor, " m"]) -> Int64[Tensor, " m"]:
    _, inverse, size = torch.unique(labels, return_inverse=True, return_counts=True)
    return size[inverse]
