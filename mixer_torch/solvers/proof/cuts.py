"""Cuts: inequalities that every clustering fulfils, and the search for those that x violates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64
from scipy.sparse import csr_array

from mixer_torch.solvers.compiled import compiled, mix

# Of the sum of all magnitudes: what float64 (1.1e-16) loses in some 900 additions. NumPy's pairwise
# sums lose less than 1e-14; sums over the cuts of one pair have fewer terms than that.
ROUNDING = 1e-13


class Cuts(NamedTuple):
    """2-partition inequalities with one node on one side (Grötschel and Wakabayashi, 1990).

        sum_{c in T} x_bc - sum_{c < d in T} x_cd <= 1        for a centre b and a set T without b

    If b is with k nodes of T then these k are together: k - k (k - 1) / 2 <= 1. With two nodes in T
    this is the triangle inequality. With T inside one view, where x is 0 between any two nodes, it
    says that b is with at most one of them: the row of an assignment problem. So one kind of
    cut, found by one search, serves for all constraints.
    """

    violation: np.ndarray  # (K,) how much more than 1 the left side is
    centre: np.ndarray  # (K,) b
    start: np.ndarray  # (K + 1,) T of cut k is member[start[k]:start[k + 1]]
    member: np.ndarray  # nodes

    def __len__(self) -> int:
        return len(self.centre)

    @classmethod
    def none(cls) -> Cuts:
        """No cuts."""
        integers = np.zeros(0, np.int64)
        return cls(np.zeros(0), integers, np.zeros(1, np.int64), integers)

    def joined(self, other: Cuts) -> Cuts:
        """These, then others."""
        return Cuts(
            np.concatenate([self.violation, other.violation]),
            np.concatenate([self.centre, other.centre]),
            np.concatenate([self.start, other.start[1:] + self.start[-1]]),
            np.concatenate([self.member, other.member]),
        )

    def largest(self, count: int) -> Cuts:
        """The ones that are violated most."""
        return self.select(np.argsort(-self.violation, kind="stable")[:count])

    def select(self, chosen: np.ndarray) -> Cuts:
        """Some of them: indices, or a mask."""
        chosen = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
        size = np.diff(self.start)[chosen]
        start = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
        place = np.arange(start[-1]) + np.repeat(self.start[:-1][chosen] - start[:-1], size)
        return Cuts(self.violation[chosen], self.centre[chosen], start, self.member[place])


def separate(x: np.ndarray, tolerance: float, limit: int, starts: int = 8) -> Cuts:
    """Cuts that x violates, the larger ones first, then triangles, the worst of each first.

    All triangles are checked: where none comes back, none is violated. The larger ones come from a
    heuristic.

    Args:
        x: (n, n) symmetric, in [0, 1], 0 on the diagonal.
        tolerance: Smallest violation that counts.
        limit: How many triangles, and how many larger ones, come back at most.
        starts: Greedy attempts at each centre.
    """
    larger = Cuts(*_partitions(x, tolerance, starts)).largest(limit)
    return larger.joined(Cuts(*_triangles(x, tolerance)).largest(limit))


@compiled
def _triangles(x, tolerance):
    """All violated triangle inequalities: counted first, then listed."""
    n = len(x)
    near = np.empty(n, np.int64)
    found = 0
    for fill in range(2):
        if fill == 0:
            centre, violation, member = near, x[:0, 0].copy(), near
        else:
            centre, violation = np.empty(found, np.int64), np.empty(found)
            member = np.empty(2 * found, np.int64)
            found = 0
        for b in range(n):
            count = 0
            for a in range(n):
                if x[b, a] > tolerance:
                    near[count] = a
                    count += 1
            for i in range(count):
                for j in range(i):
                    excess = x[b, near[i]] + x[b, near[j]] - x[near[i], near[j]] - 1
                    if excess > tolerance:
                        if fill == 1:
                            centre[found], violation[found] = b, excess
                            member[2 * found], member[2 * found + 1] = near[j], near[i]
                        found += 1
    return violation, centre, 2 * np.arange(found + 1), member


@compiled
def _partitions(x, tolerance, starts):
    """Violated inequalities with three nodes or more in T, grown greedily from several starts."""
    n = len(x)
    violation, centre = np.empty(n * starts), np.empty(n * starts, np.int64)
    start = np.zeros(n * starts + 1, np.int64)
    member = np.empty(n * starts * 4, np.int64)
    seen = np.empty(starts, np.uint64)
    gain = np.empty(n)
    found = 0
    for b in range(n):
        order = np.argsort(-x[b])
        distinct = 0
        for s in range(min(starts, n)):
            if x[b, order[s]] <= tolerance:
                break
            end, total, name = start[found], 0.0, np.uint64(0)
            gain[:] = x[b]
            c = order[s]
            while gain[c] > tolerance:
                if end == len(member):
                    member = np.concatenate((member, member))
                member[end] = c
                end += 1
                total += gain[c]
                name ^= mix(np.uint64(c + 1))
                gain -= x[c]
                gain[c] = -1.0
                c = np.argmax(gain)
            known = end - start[found] < 3 or total - 1 <= tolerance
            for k in range(distinct):
                known = known or seen[k] == name
            if not known:
                seen[distinct] = name
                distinct += 1
                violation[found], centre[found] = total - 1, b
                found += 1
                start[found] = end
    return violation[:found], centre[:found], start[: found + 1], member[: start[found]]


class PairVariables:
    """One variable x_e for each pair of nodes that may be together.

    Args:
        conflict: (n, n) which two nodes may not be together.
    """

    def __init__(self, conflict: Bool[np.ndarray, "n n"]) -> None:
        self.first, self.second = np.nonzero(np.triu(~conflict, 1))
        self.index = np.full(conflict.shape, -1, np.int64)
        self.index[self.first, self.second] = np.arange(len(self))
        self.index[self.second, self.first] = np.arange(len(self))

    def __len__(self) -> int:
        return len(self.first)

    def vector(self, matrix: Float64[np.ndarray, "n n"]) -> Float64[np.ndarray, " V"]:
        """The entries of a symmetric matrix that have variables."""
        return matrix[self.first, self.second]

    def matrix(self, vector: Float64[np.ndarray, " V"]) -> Float64[np.ndarray, "n n"]:
        """The symmetric matrix of a vector, 0 where there is no variable."""
        full = np.zeros(self.index.shape)
        full[self.first, self.second] = full[self.second, self.first] = vector
        return full

    def rows(self, cuts: Cuts) -> csr_array:
        """(K, V) the matrix A of the cuts A x <= 1."""
        start, variable, coefficient = _rows(self.index, cuts.centre, cuts.start, cuts.member)
        return csr_array((coefficient, variable, start), shape=(len(cuts), len(self)))


def lagrangian_bound(
    cost: Float64[np.ndarray, " V"],
    rows: csr_array,
    y: Float64[np.ndarray, " K"],
    low: Float64[np.ndarray, " V"] | float = 0.0,
    high: Float64[np.ndarray, " V"] | float = 1.0,
) -> tuple[float, Float64[np.ndarray, " V"]]:
    """A lower bound of every clustering with low <= x <= high, for any y >= 0.

        L(y) = sum_e min(r_e low_e, r_e high_e) - sum y,     r = cost + A^T y,     cuts A x <= 1

    It is rounded down by more than float64 sums may have lost, so that it holds whatever the
    tolerances of the solver that y comes from.

    Returns:
        L(y), and r.
    """
    reduced = cost + rows.T @ y
    magnitude = np.abs(cost).sum() + (y * (1 + np.diff(rows.indptr))).sum()
    least = np.minimum(reduced * low, reduced * high).sum() - y.sum()
    return float(least - ROUNDING * magnitude), reduced


@compiled
def _rows(pair_index, centre, start, member):
    """Compressed rows of cuts: start (K + 1,), variable, coefficient; index -1 has no variable."""
    size = 0
    for k in range(len(centre)):
        t = start[k + 1] - start[k]
        size += t + t * (t - 1) // 2
    first = np.zeros(len(centre) + 1, np.int64)
    variable, coefficient = np.empty(size, np.int64), np.empty(size)
    end = 0
    for k in range(len(centre)):
        for i in range(start[k], start[k + 1]):
            e = pair_index[centre[k], member[i]]
            if e >= 0:
                variable[end], coefficient[end] = e, 1.0
                end += 1
            for j in range(start[k], i):
                e = pair_index[member[i], member[j]]
                if e >= 0:
                    variable[end], coefficient[end] = e, -1.0
                    end += 1
        first[k + 1] = end
    return first, variable[:end], coefficient[:end]
