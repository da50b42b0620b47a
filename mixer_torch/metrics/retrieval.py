"""How well a similarity finds an object in the other cameras: the figures of re-identification."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.sparse import csr_array
from torch import Tensor

from mixer_torch.affinity import Affinity
from mixer_torch.fusion import Fusion
from mixer_torch.observations import Observations

RANKS = (1, 5)
CHUNK = 512
"""Queries whose similarities to all others are held at a time."""
Rows = Callable[[int, int], Tensor]
"""Similarities of the queries from one number up to another, (queries, m)."""


def retrieval(
    similarity: Any, identity: Any, camera: Any, ranks: Sequence[int] = RANKS
) -> dict[str, float]:
    """Rank-k and mean average precision of finding each object in the other cameras.

    Each observation of a known identity is a query once; its gallery is all that other cameras saw,
    clutter included. Queries whose object no other camera saw are left out (there is nothing to
    find); of m observations in one camera, none is left.

    ``rank_k`` is the share of queries with a true match among the first k of the gallery, a point
    of the cumulative match characteristic (Gray, Brennan and Tao 2007). ``map`` is the mean over
    queries of the average precision, the mean over the true matches of the precision at the place
    where each is found (Zheng et al. 2015, there with interpolation between places, here without,
    as in scikit-learn). Ties are broken against the query: what is as similar as a true match
    counts as found before or with it.

    Args:
        similarity: (m, m), larger for more alike; the diagonal is not read.
        identity: (m,) integers, negative where it is not known.
        camera: (m,) integers.
        ranks: The k of ``rank_k``, each at least 1.

    Returns:
        ``rank1`` and so on by k, ``map``, and ``queries``, their number; without a query the others
        are NaN.

    Raises:
        ValueError: Lengths differ, the similarity has NaN, or a rank is < 1.
    """
    full = torch.as_tensor(similarity)
    m = len(torch.as_tensor(identity))
    if full.shape != (m, m):
        raise ValueError(
            f"similarity: expected shape ({m}, {m}) for {m} identities, got {tuple(full.shape)}"
        )
    return retrieval_of_rows(lambda start, end: full[start:end], identity, camera, ranks)


def retrieval_of_rows(
    rows: Rows, identity: Any, camera: Any, ranks: Sequence[int] = RANKS
) -> dict[str, float]:
    """:func:`retrieval` with similarities made when they are needed, some queries at a time."""
    identity, camera = torch.as_tensor(identity), torch.as_tensor(camera)
    if identity.shape != camera.shape or identity.ndim != 1:
        raise ValueError(
            "identity, camera: expected one length, "
            f"got shapes {tuple(identity.shape)} and {tuple(camera.shape)}"
        )
    if any(rank < 1 for rank in ranks):
        raise ValueError(f"ranks: expected integers >= 1, got {list(ranks)}")
    places, precisions = [], []
    for start in range(0, len(identity), CHUNK):
        end = min(start + CHUNK, len(identity))
        values = rows(start, end)
        gallery = camera[start:end, None] != camera
        same = gallery & (identity[start:end, None] == identity) & (identity[start:end, None] >= 0)
        if bool(values[gallery.to(values.device)].isnan().any()):
            raise ValueError("similarity: expected numbers, got NaN")
        asked = same.any(1)
        ranked = _ranked(values.to(gallery.device)[asked], gallery[asked], same[asked])
        places.append(ranked[0])
        precisions.append(ranked[1])
    place = torch.cat(places) if places else torch.zeros(0)
    precision = torch.cat(precisions) if precisions else torch.zeros(0)
    found = {f"rank{k}": float((place <= k).double().mean()) for k in ranks}
    return found | {"map": float(precision.double().mean()), "queries": len(place)}


def _ranked(
    value: Float[Tensor, "q m"], gallery: Bool[Tensor, "q m"], same: Bool[Tensor, "q m"]
) -> tuple[Float[Tensor, " q"], Float[Tensor, " q"]]:
    """Place of the first true match, and average precision, of each query."""
    seen, hits = at_least(value, gallery), at_least(value, same)
    precision = torch.where(same, hits / seen.clamp(min=1), 0.0).sum(1) / same.sum(1)
    strangers = torch.where(same, (seen - hits).double(), torch.inf)
    return strangers.min(1).values + 1, precision


def at_least(value: Float[Tensor, "q m"], chosen: Bool[Tensor, "q m"]) -> Tensor:
    """How many of the chosen of a row have at least each value of the row, (q, m)."""
    ordered = value.masked_fill(~chosen, -torch.inf).sort(1).values
    below = torch.searchsorted(ordered, value.contiguous())
    count = value.shape[1] - below
    return count.minimum(chosen.sum(1, keepdim=True))


def retrieval_of_affinity(
    affinity: Affinity, observations: Observations, fusion: Fusion | None = None
) -> dict[str, float] | None:
    """:func:`retrieval` by the fused score: of two pairs the one of lower cost is more alike.

    A pair that is not listed costs 0. Where observations lie in views, which observations of one
    camera are of one object is known in part, so this is for galleries of single images.

    Args:
        affinity: How alike.
        observations: With ``identity`` and ``camera``.
        fusion: How modalities add up; the paper's ``LinearFusion()`` if None.

    Returns:
        None where identities or cameras are not known, some observation lies in a view, or no
        object was seen by two cameras.
    """
    features = observations.features
    if not {"identity", "camera"} <= set(features) or bool((observations.view >= 0).any()):
        return None
    identity, camera = features["identity"].cpu(), features["camera"].cpu()
    with torch.no_grad():
        similarity = -affinity.cost(fusion).double().cpu().numpy()
    a, b = affinity.pairs.cpu().numpy()
    ends = np.concatenate([a, b]), np.concatenate([b, a])
    m = len(identity)
    matrix = csr_array((np.concatenate([similarity, similarity]), ends), shape=(m, m))
    found = retrieval_of_rows(
        lambda start, end: torch.from_numpy(matrix[start:end].toarray()), identity, camera
    )
    return found if found["queries"] else None
