"""k-reciprocal encoding: observations of one object have the same nearest neighbours."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

SHARED = 2 / 3
"""Share of a candidate's own set that has to lie in the set that it extends (Zhong et al. 2017)."""
AVERAGED = 5
"""Nearest observations, itself included, over which an encoding is averaged: the local query
expansion of Zhong et al. 2017, with 6 there."""
ELEMENTS = 1 << 24
"""Entries of encodings that are compared at a time: 64 MiB of float32."""


def reciprocal_encoding(vectors: Float[Tensor, "m d"], k: int) -> Float[Tensor, "m m"]:
    """Fuzzy sets of neighbours, as rows that sum to 1 (Zhong, Zheng, Cao and Li 2017).

    R(i) holds those j for which i and j are among the k nearest of each other; the sets of k/2 of
    its members are added where most of them lies in R(i). The row of i is exp(cosine) on R(i),
    scaled to sum 1 and averaged over the nearest of i. Time and memory grow with m².

    Args:
        vectors: Unit vectors; a row with NaN is a neighbour of none, and its encoding is NaN.
        k: Number of neighbours; about as many as there are observations of an object.
    """
    if not len(vectors):
        return vectors.new_zeros(0, 0)
    cosine = vectors @ vectors.T
    known = vectors.isfinite().all(1)
    cosine = cosine.masked_fill(~(known[:, None] & known), -torch.inf)
    full, half = (_mutual(cosine, count) for count in (k, round(k / 2)))
    members, candidates = full.to(cosine.dtype), half.to(cosine.dtype)
    inside = members @ candidates.T > SHARED * candidates.sum(1)
    added = (full & inside).to(cosine.dtype) @ candidates > 0
    weight = cosine.exp() * (full | added)
    weight = weight / weight.sum(1, keepdim=True)
    nearest = cosine.topk(min(AVERAGED, len(cosine)), 1)
    share = nearest.values.isfinite().to(weight.dtype)
    share = share / share.sum(1, keepdim=True)
    averaging = torch.zeros_like(weight).scatter_(1, nearest.indices, share)
    return (averaging @ weight.nan_to_num(0.0)).masked_fill(~known[:, None], torch.nan)


def _mutual(cosine: Float[Tensor, "m m"], k: int) -> Bool[Tensor, "m m"]:
    """Whether two are among the k nearest of each other; true of each with itself."""
    nearest = cosine.topk(min(k + 1, len(cosine)), 1).indices
    near = torch.zeros_like(cosine, dtype=torch.bool).scatter_(1, nearest, True)
    return near & near.T & cosine.isfinite()


def jaccard(encoding: Float[Tensor, "m m"], pairs: Int64[Tensor, "2 P"]) -> Float[Tensor, " P"]:
    """Σ min / Σ max of the rows of each pair: 1 for the same neighbours, 0 for none in common."""
    found = []
    for part in pairs.split(max(ELEMENTS // max(len(encoding), 1), 1), dim=1):
        common = torch.minimum(encoding[part[0]], encoding[part[1]]).sum(1)
        found.append(common / (2 - common))
    return torch.cat(found) if found else encoding.new_zeros(0)
