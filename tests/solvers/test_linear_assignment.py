"""Linear assignment: against scipy's."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from mixer_torch.solvers.compiled import compiled
from mixer_torch.solvers.search.linear_assignment import assign, assignment_scratch


@compiled
def matched(cost):
    scratch = assignment_scratch(*cost.shape)
    scratch.cost[:] = cost
    assign(scratch, *cost.shape)
    return scratch.match


@pytest.mark.parametrize("seed", range(20))
def test_as_cheap_as_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = int(rng.integers(1, 9))
    columns = rows + int(rng.integers(0, 6))
    cost = rng.normal(size=(rows, columns)).round(int(rng.integers(0, 6)))
    match = matched(cost)
    column = np.flatnonzero(match >= 0)
    assert sorted(match[column].tolist()) == list(range(rows))
    expected = cost[linear_sum_assignment(cost)].sum()
    assert np.isclose(cost[match[column], column].sum(), expected)
