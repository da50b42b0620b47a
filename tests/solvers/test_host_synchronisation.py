"""The solver where the scores are on a device: nothing is mixed up, and the host hardly ever waits.

The device is pretended (``pretended_device.py``): it holds everywhere that operations do not mix
devices, that the path for devices gives what the CPU's gives, and how often the host has to wait.
"""

import pytest
import torch
from paper import evaluated
from pretended_device import DEVICE, Generator, PretendedDevice

import mixer_torch as mx
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers import eigen
from mixer_torch.solvers.gradient import graduated_non_convexity as graduated
from mixer_torch.solvers.gradient import penalty_doubling, relaxation
from mixer_torch.solvers.gradient.batch import Batch
from mixer_torch.solvers.gradient.momentum import travel
from mixer_torch.solvers.gradient.projection import project_rows
from mixer_torch.solvers.gradient.relaxation import distinctness_matrix
from mixer_torch.solvers.mixer import Mixer

SHAPE = 3, 12, 5
LARGE = eigen.SMALL + 2  # observations, for Lanczos' method


@pytest.fixture
def device(monkeypatch):
    monkeypatch.setattr(torch, "Generator", Generator)
    with PretendedDevice() as device:
        yield device
    assert not device.unsteady


def batch(problems=SHAPE[0], m=SHAPE[1], seed=0, device="cpu"):
    generator = torch.Generator().manual_seed(seed)
    cost = 2 * torch.rand(problems, m, m, generator=generator) - 1
    view = torch.arange(m) // 4
    mask = torch.arange(m) < m - torch.arange(problems)[:, None]
    real = mask[:, :, None] & mask[:, None, :]
    apart = (distinctness_matrix(view) * real).to(device)
    cost = ((cost + cost.mT) * real).to(device) * (1 - apart)
    return Batch(cost - torch.diag_embed(cost.diagonal(dim1=1, dim2=2)), apart, mask.to(device))


def rows(seed=0, shape=SHAPE):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


LOOKS = {
    "_local_scalar_dense": lambda x: x.sum().item(),
    "is_nonzero": lambda x: bool((x > 0).any()),
    "equal": lambda x: torch.equal(x, x),
    "nonzero": lambda x: (x > 0).nonzero(),
    "_unique2": lambda x: torch.unique(x),
    "index by a mask": lambda x: x[x > 0],
    "index from the host": lambda x: x[torch.tensor([0])],
    "to the host": lambda x: x.cpu(),
    "to the device": lambda x: x + torch.ones(3).to(x.device),
    "where with a number on the host": lambda x: torch.where(x > 0, x, torch.tensor(1.0)),
    "_linalg_eigh": lambda x: torch.linalg.eigvalsh(x[:, None] * x),
}


@pytest.mark.parametrize("name", LOOKS)
def test_the_pretended_device_sees_the_host_wait(device, name):
    x = torch.arange(3.0).to(DEVICE)
    device.waits.clear()
    LOOKS[name](x)
    found = set(device.waits)
    assert found == ({"_local_scalar_dense"} if name == "is_nonzero" else {name})


def test_the_pretended_device_lets_nothing_be_mixed(device):
    x = torch.arange(3.0).to(DEVICE)
    device.waits.clear()
    for mix in (lambda: x + torch.ones(3), lambda: torch.ones(2, 3) @ x, lambda: x.add_(rows()[0])):
        with pytest.raises(RuntimeError, match="all tensors on one device"):
            mix()
    with pytest.raises(RuntimeError, match="by a copy"):
        torch.tensor([1.0], device=DEVICE) + x
    assert (2 * x + torch.tensor(1.0)).value.tolist() == [1, 3, 5]
    x[1:] = 7
    x.mul_(2)
    assert torch.add(x, 1, out=torch.empty_like(x)).value.tolist() == [1, 15, 15]
    assert not device.waits


UNSTEADY = {
    "scatter_add": lambda x, i: x.scatter_add(0, i, x),
    "index_add_": lambda x, i: x.clone().index_add_(0, i, x),
    "scatter_reduce": lambda x, i: x.scatter_reduce(0, i, x, "mean"),
    "nanmedian": lambda x, i: x.nanmedian(0),
    "cumsum": lambda x, i: x.cumsum(0),
    "bincount": lambda x, i: torch.bincount(i, x),
    "index_put_": lambda x, i: x.clone().index_put_((i,), x),
}


@pytest.mark.parametrize("name", UNSTEADY)
def test_the_pretended_device_knows_what_may_differ_the_next_time(name):
    steady = (
        lambda x, i: x.scatter_reduce(0, i, x, "amin"),
        lambda x, i: x.expand(2, 3).cumsum(1),
        lambda x, i: torch.bincount(i),
        lambda x, i: x.clone().index_put_((torch.arange(3).to(DEVICE),), x),
    )
    with PretendedDevice() as device:
        arguments = torch.arange(3.0).to(DEVICE), torch.tensor([0, 1, 1]).to(DEVICE)
        for operation in steady:
            operation(*arguments)
        assert not device.unsteady
        UNSTEADY[name](*arguments)
        assert device.unsteady == {name: 1}


def test_the_host_waits_for_no_step_of_annealing(device):
    for m, precision in ((12, "float32"), (12, "bfloat16"), (12, "tf32"), (LARGE, "float32")):
        there = batch(m=m, device=DEVICE)
        device.waits.clear()
        result = graduated.graduated_descent(there, SHAPE[2], precision=precision)
        assert device.waits == {"_linalg_eigh": 1}
        assert result.history.shape == (100, SHAPE[0])
        assert {x.device for x in vars(result).values()} == {DEVICE}


def test_the_host_waits_once_for_a_block_of_the_paper_s_schedule(device):
    there, start = batch(device=DEVICE), rows().to(DEVICE)
    device.waits.clear()
    result = penalty_doubling.penalised_descent(there, start, max_iterations=1000)
    blocks, rest = divmod(len(result.history), penalty_doubling.BLOCK)
    assert rest == 0
    assert 1 < blocks < 100
    assert device.waits == {"_local_scalar_dense": blocks}
    device.waits.clear()
    short = penalty_doubling.penalised_descent(
        there, start, max_iterations=penalty_doubling.BLOCK - 1
    )
    assert not device.waits
    torch.testing.assert_close(
        short.history.value, result.history.value[: penalty_doubling.BLOCK - 1]
    )


@pytest.mark.parametrize("m", [12, LARGE])
def test_annealing_gives_what_the_cpu_gives(device, m):
    expected = graduated.graduated_descent(batch(m=m), SHAPE[2], iterations=20)
    found = graduated.graduated_descent(batch(m=m, device=DEVICE), SHAPE[2], iterations=20)
    for name, value in vars(expected).items():
        torch.testing.assert_close(getattr(found, name).value, value, atol=2e-4, rtol=2e-4)


@pytest.mark.parametrize("chosen", ["none", "ieee", "tf32"])
def test_what_the_user_chose_for_products_is_left_alone(chosen):
    products = torch.backends.cuda.matmul
    if not hasattr(products, "fp32_precision"):
        pytest.skip("this torch has one switch only")
    before, inside = products.fp32_precision, []
    try:
        products.fp32_precision = chosen
        for precision in ("float32", "tf32", "bfloat16"):
            with graduated._allowed_tf32(precision, torch.device("cpu")):
                assert products.fp32_precision == chosen
            with graduated._allowed_tf32(precision, torch.device("cuda")):
                inside.append(products.fp32_precision)
            assert products.fp32_precision == chosen
            graduated.graduated_descent(batch(), SHAPE[2], iterations=3, precision=precision)
    finally:
        products.fp32_precision = before
    assert inside == [chosen, "tf32", chosen]


def test_the_paper_s_schedule_gives_what_the_cpu_gives(device):
    arguments = {"max_iterations": 20, "projection": "row_sum_at_most_one"}
    expected = penalty_doubling.penalised_descent(batch(), rows(), **arguments)
    found = penalty_doubling.penalised_descent(batch(device=DEVICE), rows().to(DEVICE), **arguments)
    for name, value in vars(expected).items():
        torch.testing.assert_close(getattr(found, name).value, value, atol=1e-4, rtol=1e-4)


def test_both_paths_of_a_step_do_the_same(device):
    keep = rows(3, SHAPE[:2]) > 0.2
    hold, back = rows(4, (2, 3, SHAPE[0]))
    arguments = project_rows(rows(), keep), hold, -back, keep
    matrix, loose = rows(1, (SHAPE[0], SHAPE[1], SHAPE[1])), rows(2)
    at_most = hold[0] > hold[0].median()
    there = [x.to(DEVICE) for x in (*arguments, matrix, loose, at_most)]
    device.waits.clear()
    found = travel(*there[:4], lambda t, ahead: (t + 1) * torch.bmm(there[4], ahead))
    projected = project_rows(there[5], there[3], there[6])
    assert not device.waits
    expected = travel(*arguments, lambda t, ahead: (t + 1) * torch.bmm(matrix, ahead))
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one.value, other, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(projected.value, project_rows(loose, keep, at_most))


def test_the_relaxed_problem_makes_nobody_wait(device):
    there = batch(device=DEVICE)
    assignment, penalty = rows().to(DEVICE), rows(1, SHAPE[:1]).to(DEVICE)
    device.waits.clear()
    point = evaluated(assignment, there.cost, there.distinctness)
    assert point.objective(penalty).shape == (3,)
    assert point.gradient(penalty).shape == SHAPE
    assert relaxation.is_binary(assignment).device == DEVICE
    assert not device.waits


SETTINGS = [
    {},
    {"refine": False, "schedule": "anneal"},
    {"refine": False, "max_iterations": 100},
    {"refine": False, "max_iterations": 10},  # ends before it is binary
]


@pytest.mark.parametrize("arguments", SETTINGS, ids=str)
def test_the_host_waits_as_often_for_many_problems_as_for_few(device, arguments):
    scene = {"objects": 4, "views": 4, "visible": 1.0, "wrong": 0.02, "noise": 0.1}
    waits = {}
    for count in (4, 32):
        affinities = [synthetic(seed=seed, **scene)[0] for seed in range(count)]
        there = [affinity.to(DEVICE) for affinity in affinities]
        device.waits.clear()
        found = mx.solve(there, Mixer(**arguments))
        waits[count] = dict(device.waits)
        waits[count].pop("_local_scalar_dense", None)  # one a block, and problems differ in those
        for own, expected in zip(found, mx.solve(affinities, Mixer(**arguments)), strict=True):
            assert own.labels.device == DEVICE
            assert torch.equal(own.labels.value, expected.labels)
            assert own.objective == pytest.approx(expected.objective, abs=1e-4)
    assert waits[4] == waits[32]
    assert waits[4]["to the host"] <= 9


def test_the_two_schedules_after_one_another_look_once_where_to_go_on(device):
    there = Batch(*(torch.cat([x, x]) for x in vars(batch(device=DEVICE)).values()))
    device.waits.clear()
    graduated.GraduatedNonConvexity().descend(there, 4, max_iterations=120, seed=0)
    assert device.waits.pop("nonzero") == 1
    assert set(device.waits) <= {"_linalg_eigh", "_local_scalar_dense"}


@pytest.mark.cuda
def test_a_gpu_waits_for_no_step(monkeypatch):
    there, start = batch(device="cuda"), rows().to("cuda")
    found = eigen.extreme_eigenvalues(there.cost)
    monkeypatch.setattr(graduated, "extreme_eigenvalues", lambda cost, seed: found)
    torch.cuda.set_sync_debug_mode("error")
    try:
        with pytest.raises(RuntimeError, match="synchroniz"):
            start.sum().item()
        for precision in ("float32", "tf32", "bfloat16"):
            graduated.graduated_descent(there, SHAPE[2], precision=precision)
        penalty_doubling.penalised_descent(there, start, max_iterations=penalty_doubling.BLOCK - 1)
    finally:
        torch.cuda.set_sync_debug_mode("default")


@pytest.mark.cuda
def test_a_gpu_gives_what_the_cpu_gives():
    expected = graduated.graduated_descent(batch(), SHAPE[2], iterations=20)
    found = graduated.graduated_descent(batch(device="cuda"), SHAPE[2], iterations=20)
    again = graduated.graduated_descent(batch(device="cuda"), SHAPE[2], iterations=20)
    for name in ("iterations", "penalty"):
        assert torch.equal(getattr(found, name).cpu(), getattr(expected, name))
    assert torch.equal(found.assignment, again.assignment)
    assert torch.equal(found.history, again.history)
