"""The optimum by looking at every clustering, for problems of up to eight nodes."""

from functools import cache

import numpy as np
import torch

from mixer_torch.solvers.problem import Problem


@cache
def clusterings(n):
    """All partitions of n nodes as labels, one a row."""
    rows = [()]
    for _ in range(n):
        rows = [(*row, c) for row in rows for c in range(max(row, default=-1) + 2)]
    return np.array(rows, dtype=np.int64).reshape(len(rows), n)


def optimum(cost, forbidden, demanded=()):
    """Least cost of a clustering without a forbidden pair and with all demanded ones."""
    labels = clusterings(len(cost))
    together = labels[:, :, None] == labels[:, None]
    value = (together * cost).sum((1, 2)) / 2
    value[(together & forbidden).any((1, 2))] = np.inf
    for a, b in demanded:
        value[~together[:, a, b]] = np.inf
    return value.min()


def random_problem(rng, m=None, dtype=torch.float64):
    """A problem with its dense cost and forbidden pairs: views or none, ties or none, any scale."""
    m = int(rng.integers(1, 9)) if m is None else m
    view = rng.integers(0, rng.integers(1, m + 1), m) if rng.random() < 0.7 else np.arange(m)
    view = np.unique(view, return_inverse=True)[1].reshape(-1)
    ties = rng.random() < 0.4
    cost = rng.integers(-3, 4, (m, m)).astype(float) if ties else rng.normal(size=(m, m))
    cost = np.triu(cost * rng.choice([1.0, 1.0, 1e6, 1e-3]), 1)
    cost[rng.random((m, m)) < rng.choice([0.0, 0.4])] = 0
    forbidden = (view[:, None] == view) & ~np.eye(m, dtype=bool)
    cost[forbidden] = 0
    pairs = np.stack(np.nonzero(np.triu(~forbidden, 1)))
    value = torch.as_tensor(cost[pairs[0], pairs[1]], dtype=dtype)
    cost = np.zeros((m, m))
    cost[pairs[0], pairs[1]] = value.double().numpy()
    problem = Problem(
        torch.as_tensor(pairs), value, torch.as_tensor(view), torch.full_like(value, 0.5)
    )
    return problem, cost + cost.T, forbidden
