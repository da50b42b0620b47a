"""Many tensors moved with one copy."""

import pytest
import torch
from pretended_device import DEVICE, PretendedDevice

from mixer_torch.solvers.transfer import on_devices, on_host, through_host


def example():
    return [
        torch.arange(6).view(2, 3),
        torch.tensor([0.5, -1.0]),
        torch.zeros(0, 4, dtype=torch.int64),
        torch.tensor(7),
        torch.tensor([[True], [False]]),
        torch.tensor([2.5]).requires_grad_(),
    ]


def test_what_is_on_the_host_is_not_copied():
    tensors = example()[:-1]
    moved = on_host(tensors)
    assert all(a.data_ptr() == b.data_ptr() for a, b in zip(tensors, moved, strict=True))
    assert on_host([]) == []


def test_values_and_shapes_survive_with_one_copy_for_each_dtype():
    with PretendedDevice() as device:
        there = on_devices(example(), [DEVICE] * 6)
        assert {tensor.device for tensor in there} == {DEVICE}
        assert not device.waits.total()
        here = on_host(there)
        assert device.waits == {"to the host": 3}
    for expected, found in zip(example(), here, strict=True):
        assert not found.requires_grad
        assert found.dtype == expected.dtype
        assert torch.equal(found, expected)


def test_each_result_is_where_its_argument_was():
    with PretendedDevice() as device:
        tensors = [torch.arange(3), torch.arange(4).to(DEVICE), torch.arange(5).to(DEVICE)]
        device.waits.clear()
        found = through_host(lambda x: x.float().mean()[None], tensors)
        assert [tensor.device.type for tensor in found] == ["cpu", "meta", "meta"]
        assert device.waits == {"to the host": 1}
        assert torch.cat(on_host(found)).tolist() == [1, 1.5, 2]


def test_every_tensor_needs_a_device():
    with pytest.raises(ValueError, match="argument 2"):
        on_devices(example(), [DEVICE])
