"""What every solver promises. The subjects are found by themselves: all in mixer_torch.solvers."""

import importlib
import inspect
import pkgutil

import pytest
import torch
from pretended_device import DEVICE, Generator, PretendedDevice

import mixer_torch as mx
import mixer_torch.solvers
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.problem import is_distinct, objective_of, problem_of


def find_solvers():
    found = set()
    for module in pkgutil.iter_modules(mixer_torch.solvers.__path__):
        name = f"{mixer_torch.solvers.__name__}.{module.name}"
        for value in vars(importlib.import_module(name)).values():
            if inspect.isclass(value) and issubclass(value, mx.Solver):
                found.add(value)
    return sorted((s for s in found if not inspect.isabstract(s)), key=lambda s: s.__name__)


SOLVERS = find_solvers()
every_solver = pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.__name__)


def scene(seed=0, **arguments):
    return synthetic(**{"objects": 4, "views": 4, "seed": seed} | arguments)


def check(affinity, association):
    """Everything that an association promises about the affinity that it answers."""
    assert isinstance(association.status, mx.Status)
    links = association.links
    assert links.dtype == torch.int64
    assert links.shape[0] == 2
    assert bool((links[0] < links[1]).all())
    problem = problem_of(affinity)
    if association.labels is None:
        assert association.status is mx.Status.INCONSISTENT
        cost = problem.dense_cost().double()[links[0], links[1]].sum()
    else:
        labels = association.labels
        assert labels.dtype == torch.int64
        assert labels.shape == affinity.view.shape
        assert labels.device == affinity.view.device
        assert is_distinct(labels, problem.view)
        seen = dict.fromkeys(labels.tolist())
        assert list(seen) == list(range(len(seen)))
        cost = objective_of(problem, labels)
    assert association.objective == pytest.approx(float(cost), rel=1e-5, abs=1e-5)
    if association.lower_bound is not None:
        assert association.lower_bound <= association.objective + 1e-6


def same(first, second):
    if first.labels is None or second.labels is None:
        return first.labels is second.labels and torch.equal(first.links, second.links)
    return torch.equal(first.labels, second.labels)


def test_the_solvers_are_found():
    assert {"Mixer", "Exact", "Spectral", "MatchLift", "QuickMatch"} <= {
        s.__name__ for s in SOLVERS
    }


@every_solver
def test_no_observation_and_one(solver):
    for m in (0, 1):
        affinity = mx.Affinity.from_dense(torch.ones(m, m), torch.zeros(m, dtype=torch.int64))
        association = mx.solve(affinity, solver())
        check(affinity, association)
        assert association.objective == 0
        assert association.labels.tolist() == [0] * m


@every_solver
@pytest.mark.parametrize("modalities", [1, 3])
def test_answers_are_what_they_claim(solver, modalities):
    for seed in range(3):
        affinity, _ = scene(seed, modalities=modalities, inconclusive=0.2)
        check(affinity, mx.solve(affinity, solver()))


@every_solver
def test_nothing_listed(solver):
    affinity = mx.Affinity(
        torch.zeros(2, 0, dtype=torch.int64), torch.zeros(1, 0), torch.arange(4) % 2, ("one",)
    )
    association = mx.solve(affinity, solver())
    check(affinity, association)
    assert association.objective == 0


@every_solver
def test_nothing_to_say(solver):
    affinity = mx.Affinity.from_dense(torch.full((6, 6), 0.5), torch.arange(6) % 3)
    association = mx.solve(affinity, solver())
    check(affinity, association)
    assert association.objective == 0


@every_solver
def test_one_view(solver):
    affinity = mx.Affinity.from_dense(torch.ones(4, 4), torch.zeros(4, dtype=torch.int64))
    association = mx.solve(affinity, solver())
    check(affinity, association)
    assert association.links.shape == (2, 0)


@every_solver
def test_permutations_without_noise_are_recovered(solver):
    affinity, truth = scene(visible=1.0, outliers=0.0, wrong=0.0, noise=0.0)
    association = mx.solve(affinity, solver())
    check(affinity, association)
    if solver.__name__ == "Consecutive":  # has no links beyond the next view, by its definition
        return
    assert association.labels is not None
    assert torch.equal(association.labels, truth)


@every_solver
def test_the_same_again(solver):
    affinity, _ = scene(modalities=2)
    assert same(mx.solve(affinity, solver()), mx.solve(affinity, solver()))


@every_solver
def test_order_of_observations_does_not_matter_without_noise(solver):
    affinity, _ = scene(1, outliers=0.0, wrong=0.0, noise=0.0)
    order = torch.randperm(len(affinity), generator=torch.Generator().manual_seed(0))
    shuffled = mx.Affinity.from_dense(affinity.dense()[:, order][:, :, order], affinity.view[order])
    first, second = mx.solve(affinity, solver()), mx.solve(shuffled, solver())
    check(shuffled, second)
    assert second.objective == pytest.approx(first.objective, rel=1e-4, abs=1e-4)


@every_solver
def test_inputs_are_not_written_to(solver):
    affinity, _ = scene(modalities=2)
    before = [tensor.clone() for tensor in (affinity.pairs, affinity.scores, affinity.view)]
    mx.solve(affinity, solver())
    after = (affinity.pairs, affinity.scores, affinity.view)
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))


@every_solver
def test_float64(solver):
    affinity, _ = scene(dtype=torch.float64)
    check(affinity, mx.solve(affinity, solver()))


@every_solver
def test_a_list_is_solved_in_order(solver):
    affinities = [scene(seed, views=2 + seed)[0] for seed in range(3)]
    associations = mx.solve(affinities, solver())
    for affinity, association in zip(affinities, associations, strict=True):
        check(affinity, association)


@every_solver
def test_scores_on_a_device_give_labels_there(solver, monkeypatch):
    monkeypatch.setattr(torch, "Generator", Generator)
    affinity, _ = scene(modalities=2, wrong=0.02, noise=0.1)
    expected = mx.solve(affinity, solver())
    with PretendedDevice() as device:
        found = mx.solve(affinity.to(DEVICE), solver())
        assert found.links.device == DEVICE
        assert torch.equal(found.links.cpu(), expected.links)
    assert found.objective == pytest.approx(expected.objective, abs=1e-4)
    assert not device.unsteady


@every_solver
@pytest.mark.cuda
def test_cuda(solver):
    if solver is mx.Exact:
        pytest.importorskip("highspy")
    affinity, _ = scene(modalities=2)
    affinity = affinity.to("cuda")
    first, second = mx.solve(affinity, solver()), mx.solve(affinity, solver())
    check(affinity, first)
    assert first.links.device.type == "cuda"
    assert same(first, second)
