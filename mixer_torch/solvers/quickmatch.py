"""QuickMatch: quick shift (mode seeking) whose clusters keep observations of a view distinct."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.association import Status
from mixer_torch.solvers.problem import Problem, Solution, Solver
from mixer_torch.solvers.synchronization import evidence_matrix

BETWEEN_DISTINCT = math.sqrt(2.0)  # distance of orthogonal unit vectors


class QuickMatch(Solver):
    """Quick shift over the observations, its tree broken so that clusters are distinct.

    1. Scale σ_a: the distance from a to the nearest observation of its own view.
    2. Density h(a) = sum_b exp(−d(a, b)² / 2 (bandwidth σ_b)²).
    3. Tree: the parent of a is its nearest neighbour of higher density (ties go by index).
    4. Clusters: edges of the tree in the order of increasing length; two clusters are merged by an
       edge if they share no view and the edge is shorter than ``ratio`` times the least σ in both.

    The publication works on features. Here scores are read as inner products of unit feature
    vectors: d² = 2 (1 − score), and observations of one view, which are distinct, as orthogonal
    ones. So σ = √2, a score of 0.5 is at distance 1 = 0.71 σ, and the authors' ratio of 0.67 merges
    only above a score of 0.55. By step 4 the answer is always feasible. Soft scores count by their
    value.

    Source: Tron, Zhou, Esteves and Daniilidis, Fast multi-image matching via density-based
    clustering, ICCV 2017.

    Args:
        bandwidth: Width of the density's kernel, in units of σ (the authors' default).
        ratio: Longest edge that merges, in units of σ (the authors' default).
    """

    def __init__(self, bandwidth: float = 0.25, ratio: float = 0.67) -> None:
        for name, value in (("bandwidth", bandwidth), ("ratio", ratio)):
            if not value > 0:
                raise ValueError(f"{name}: expected a number > 0, got {value}")
        self.bandwidth = bandwidth
        self.ratio = ratio

    def run(self, problem: Problem) -> Solution:
        distance = feature_distance(problem)
        scale = distance.new_full((len(problem),), BETWEEN_DISTINCT)
        parent, length = tree(distance, density(distance, self.bandwidth * scale))
        labels = merge(parent, length, self.ratio * scale, problem.view)
        return Solution(Status.CONVERGED, labels=labels)


def feature_distance(problem: Problem) -> Float[Tensor, "m m"]:
    """Distance of unit vectors whose inner products are the scores, and 0 within a view."""
    product = evidence_matrix(problem, "score").fill_diagonal_(1)
    return (2 * (1 - product)).sqrt()


def density(distance: Float[Tensor, "m m"], width: Float[Tensor, " m"]) -> Float[Tensor, " m"]:
    """Sum of Gaussian kernels, each with the width of the observation at its centre."""
    return torch.exp(-0.5 * (distance / width) ** 2).sum(1)


def tree(
    distance: Float[Tensor, "m m"], density: Float[Tensor, " m"]
) -> tuple[Int64[Tensor, " m"], Float[Tensor, " m"]]:
    """For each observation the nearest one of higher density, and how far it is.

    The observation of the highest density is its own parent, infinitely far.
    """
    index = torch.arange(len(density), device=density.device)
    higher = (density > density[:, None]) | (
        (density == density[:, None]) & (index < index[:, None])
    )
    length, parent = distance.masked_fill(~higher, torch.inf).min(1)
    return torch.where(length.isinf(), index, parent), length


def merge(
    parent: Int64[Tensor, " m"],
    length: Float[Tensor, " m"],
    limit: Float[Tensor, " m"],
    view: Int64[Tensor, " m"],
) -> Int64[Tensor, " m"]:
    """Clusters of the tree: step 4, with ``limit`` the longest edge of each observation."""
    cluster = np.arange(len(parent))
    members = [[a] for a in cluster]
    views = [{value} for value in view.tolist()]
    limits, parents, lengths = limit.tolist(), parent.tolist(), length.cpu().numpy()
    for child in np.argsort(lengths, kind="stable"):
        a, b = cluster[child], cluster[parents[child]]
        reach = min(limits[a], limits[b])
        if a == b or not lengths[child] < reach or not views[a].isdisjoint(views[b]):
            continue
        if len(members[a]) < len(members[b]):
            a, b = b, a
        cluster[members[b]] = a
        members[a] += members[b]
        views[a] |= views[b]
        limits[a] = reach
    return torch.from_numpy(cluster).to(parent.device)
