"""The gradient stage on tensors that have no values: to look at one from the host is an error.

The path for devices other than the CPU is taken, so this holds on a GPU, where such a look would
wait until the device has caught up.
"""

import pytest
import torch

from mixer_torch.solvers.gradient import annealing, descent
from mixer_torch.solvers.gradient.batch import Batch
from mixer_torch.solvers.gradient.momentum import advance, advance_anywhere
from mixer_torch.solvers.gradient.projection import project_rows

SHAPE = 3, 12, 5


@pytest.fixture
def without_values(monkeypatch):
    """A batch on the device "meta"; only draws of random numbers are replaced, it has none."""

    def first(batch, columns, seed):
        return project_rows(batch.cost[..., :columns].clone(), batch.mask)

    monkeypatch.setattr(annealing, "_first", first)
    b, m, _ = SHAPE
    cost, apart = torch.empty(2, b, m, m, device="meta")
    return Batch(cost, apart, torch.ones(b, m, dtype=torch.bool, device="meta"))


def test_values_cannot_be_looked_at(without_values):
    for look in (lambda x: x.item(), lambda x: bool(x.any()), lambda x: x[x > 0]):
        with pytest.raises((RuntimeError, NotImplementedError)):
            look(without_values.cost.sum((1, 2)))


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_annealing_never_looks(without_values, precision):
    result = annealing.anneal(without_values, SHAPE[2], precision=precision)
    assert result.assignment.shape == SHAPE
    assert result.assignment.device.type == "meta"
    assert result.history.shape == (100, 3)


def test_the_schedule_of_the_paper_looks_every_tenth_step(without_values, monkeypatch):
    generator = torch.Generator()
    monkeypatch.setattr(torch, "Generator", lambda device: generator)
    start = without_values.cost[..., : SHAPE[2]]
    with pytest.raises((RuntimeError, NotImplementedError)):
        descent.descend(without_values, start, max_iterations=descent.CHECK_EVERY)
    result = descent.descend(without_values, start, max_iterations=descent.CHECK_EVERY - 1)
    assert result.assignment.shape == SHAPE


def test_both_paths_of_a_step_do_the_same():
    generator = torch.Generator().manual_seed(0)
    assignment, ahead, product = torch.rand(3, *SHAPE, generator=generator)
    hold, back = torch.rand(2, SHAPE[0], generator=generator)
    keep = torch.rand(SHAPE[:2], generator=generator) > 0.2
    assignment, ahead = (project_rows(x, keep) for x in (assignment, ahead))
    arguments = product, hold, -back, keep
    expected = advance_anywhere(assignment.clone(), ahead.clone(), *arguments)
    found = advance(assignment.clone(), ahead.clone(), *arguments)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-5)
