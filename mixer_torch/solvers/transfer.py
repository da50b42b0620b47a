"""Many tensors from a device to the host and back, with one copy for all of them.

A copy makes the host wait until the device has caught up, however little is copied: for a list of
problems the number of copies counts, not their size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor


def on_host(tensors: Sequence[Tensor]) -> list[Tensor]:
    """The tensors on the CPU, without their gradients; those that are there are not copied.

    One copy is made for each dtype on each device.
    """
    return _packed([tensor.detach() for tensor in tensors], [torch.device("cpu")] * len(tensors))


def on_devices(tensors: Sequence[Tensor], devices: Sequence[torch.device]) -> list[Tensor]:
    """Each tensor on the device named for it, with one copy for each dtype and device.

    The host does not wait: its memory is not pinned, so it is free again when the copy is made.
    """
    return _packed(tensors, devices)


def through_host(function: Callable[[Tensor], Tensor], tensors: Sequence[Tensor]) -> list[Tensor]:
    """A function of each tensor, computed on the CPU; each result is where its argument is."""
    results = [function(tensor) for tensor in on_host(tensors)]
    return on_devices(results, [tensor.device for tensor in tensors])


def _packed(tensors: Sequence[Tensor], devices: Sequence[torch.device]) -> list[Tensor]:
    moved = list(tensors)
    groups: dict[tuple[torch.device, torch.device, torch.dtype], list[int]] = {}
    for i, (tensor, device) in enumerate(zip(tensors, devices, strict=True)):
        if tensor.device != device:
            groups.setdefault((tensor.device, device, tensor.dtype), []).append(i)
    for (_, device, _), group in groups.items():
        flat = torch.cat([tensors[i].reshape(-1) for i in group])
        # to the host, the values are needed at once
        flat = flat.to(device, non_blocking=device.type != "cpu")
        parts = flat.split([tensors[i].numel() for i in group])
        for i, part in zip(group, parts, strict=True):
            moved[i] = part.view(tensors[i].shape)
    return moved
