"""Inequalities that every clustering fulfils, and the search for those that a fraction breaks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixer_torch.solvers.compiled import compiled, mix


class Cuts(NamedTuple):
    """2-partition inequalities with one node on one side (Grötschel and Wakabayashi, 1990).

        sum_{c in T} x_bc - sum_{c < d in T} x_cd <= 1        for a centre b and a set T without b

    If b is with k nodes of T then these k are together: k - k (k - 1) / 2 <= 1. With two nodes in T
    this is the triangle inequality. With T inside one view it says that at most one of them is b:
    the row of an assignment. x is 0 for nodes that may not be together, so the same inequality
    serves for all constraints, and what lies between grows from one greedy search.

    Args:
        violation: (K,) how much more than 1 the left side is.
        centre: (K,) b.
        start: (K + 1,) T of cut k is ``member[start[k]:start[k + 1]]``.
        member: nodes.
    """

    violation: np.ndarray
    centre: np.ndarray
    start: np.ndarray
    member: np.ndarray

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
        """The ones that are broken most."""
        return self.select(np.argsort(-self.violation, kind="stable")[:count])

    def select(self, chosen: np.ndarray) -> Cuts:
        """Some of them: indices, or a mask."""
        chosen = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
        size = np.diff(self.start)[chosen]
        start = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
        place = np.arange(start[-1]) + np.repeat(self.start[:-1][chosen] - start[:-1], size)
        return Cuts(self.violation[chosen], self.centre[chosen], start, self.member[place])


def separate(x: np.ndarray, tolerance: float, limit: int, starts: int = 8) -> Cuts:
    """Inequalities that x breaks, the worst ones first.

    All triangles are looked at, so none is broken where none comes back; of the larger ones some.

    Args:
        x: (n, n) symmetric, in [0, 1], 0 on the diagonal.
        tolerance: Smallest violation that counts.
        limit: How many triangles, and how many larger ones, come back at most.
        starts: Greedy attempts at each centre.
    """
    larger = Cuts(*_partitions(x, tolerance, starts)).largest(limit)
    return larger.joined(Cuts(*_triangles(x, tolerance)).largest(limit))


@compiled
def _triangles(x, tolerance):  # type: ignore[no-untyped-def]
    """All broken triangle inequalities."""
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
def _partitions(x, tolerance, starts):  # type: ignore[no-untyped-def]
    """Broken inequalities with three nodes or more in T, grown greedily from several starts."""
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


@compiled
def rows_of(pair_index, centre, start, member):  # type: ignore[no-untyped-def]
    """Cuts as rows over the pair variables that there are.

    Args:
        pair_index: (n, n) int64 number of each pair's variable, -1 where x is 0.
        centre: Of each cut.
        start: Of each cut's members.
        member: Nodes.

    Returns:
        Compressed rows: start (K + 1,), variable, coefficient.
    """
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
