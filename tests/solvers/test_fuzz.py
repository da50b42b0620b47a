"""Odd problems: no hang, no NaN, feasible, the same again, alone and in a batch."""

import math

import pytest
import torch

import mixer_torch as mx
from mixer_torch.solvers.problem import Problem, is_distinct, objective_of

M = 13  # one more than enumeration takes


def problem(cost, view=None, keep=None, dtype=torch.float32):
    """All pairs across views, of costs that are given by pair."""
    view = torch.arange(M) if view is None else view
    pairs = torch.triu_indices(M, M, offset=1)
    listed = view[pairs[0]] != view[pairs[1]]
    listed = listed if keep is None else listed & keep(*pairs)
    value = torch.as_tensor(cost(*pairs), dtype=dtype)[listed]
    return Problem(pairs[:, listed], value, view, torch.full_like(value, 0.5))


def random(scale, seed=0):
    def cost(a, b):
        generator = torch.Generator().manual_seed(seed)
        return scale * torch.randn(len(a), generator=generator, dtype=torch.float64)

    return cost


def sign(a, b):
    return 1.0 - 2.0 * ((a * 7 + b * 5) % 3 == 0)


def value(of):
    return lambda a, b: torch.full((len(a),), of)


def twins(a, b):
    """Observations 2 i and 2 i + 1 are the same to all others."""
    table = torch.randn(M, M, generator=torch.Generator().manual_seed(1))
    return table[a // 2, b // 2]


def cases(dtype):
    some = torch.arange(M) % 4
    extreme = [random(1e6), lambda a, b: torch.where(b % 2 == 0, 1e6, -1e-3) * sign(a, b)]
    posed = {
        "costs of a million": [(cost, view) for cost in extreme for view in (None, some)],
        "exact ties": [(sign, None), (sign, some)],
        "all zero": [(value(0.0), None), (value(0.0), some)],
        "all attract": [(value(-1.0), None), (value(-1.0), some)],
        "all repel": [(value(1.0), some)],
        "one view": [(random(1.0), torch.zeros(M, dtype=torch.int64))],
        "a view each": [(random(1.0), None)],
        "duplicates": [(twins, None), (twins, some)],
        "disconnected": [(random(1.0), some, lambda a, b: a // 5 == b // 5)],
        "nothing listed": [(random(1.0), some, lambda a, b: a < 0)],
    }
    return {
        name: [problem(*arguments, dtype=dtype) for arguments in several]
        for name, several in posed.items()
    }


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", cases(torch.float32))
def test_alone_and_in_a_batch(name, dtype):
    posed = cases(dtype)[name]
    best = [mx.Exact(time_limit=20).run(one) for one in posed]
    for solver in (mx.Mixer(), mx.Exact(), mx.Mixer(refine=False)):
        alone = [solver.run(one) for one in posed]
        together = solver.run_batch(posed)
        again = solver.run_batch(posed)
        for one, optimum, *found in zip(posed, best, alone, together, again, strict=True):
            largest = float(one.cost.abs().max()) if len(one.cost) else 0.0
            for solution in found:
                objective = objective_of(one, solution.labels)
                assert math.isfinite(objective)
                assert all(map(math.isfinite, solution.stats.get("history", [])))
                assert is_distinct(solution.labels, one.view)
                assert objective >= optimum.lower_bound - 1e-6 * largest
                if isinstance(solver, mx.Exact) or solver.refine:
                    near = pytest.approx(objective_of(one, optimum.labels), abs=1e-5 * largest)
                    assert objective == near
            assert torch.equal(found[1].labels, found[2].labels)
