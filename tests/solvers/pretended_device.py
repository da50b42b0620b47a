"""A device that is not there: tensors that say they are elsewhere, and a record of every wait.

On a GPU the host runs ahead of the device. What makes it wait is not visible in results, and a
tensor left behind on the other side fails only there. So here the values of ``There`` lie in memory
of the host, but can be reached only as those of a GPU can: operations that mix devices raise, and
each operation that makes the host wait for CUDA is counted. torch says which ones those are
(``torch.cuda.set_sync_debug_mode``): looks at a value, results whose size is found by the values,
copies from one side to the other, and decompositions, which look whether they converged.

The device is called "meta", which every build of torch knows, and which has no generator of random
numbers: that of the CPU takes its place.
"""

from collections import Counter

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_iter, tree_map

DEVICE = torch.device("meta")
LOOKS = {"_local_scalar_dense", "is_nonzero", "equal", "allclose"}
SIZES = {
    "nonzero", "masked_select", "_unique", "_unique2", "unique_dim", "unique_consecutive",
    "repeat_interleave", "bincount", "isin", "segment_reduce",
}  # fmt: skip
DECOMPOSITIONS = {"_linalg_eigh", "_linalg_svd", "linalg_cholesky_ex", "linalg_qr"}
COPIES = {"_to_copy", "copy_", "copy"}


class There(torch.Tensor):
    """A tensor on the pretended device."""

    @staticmethod
    def __new__(cls, value):
        return torch.Tensor._make_wrapper_subclass(
            cls,
            value.shape,
            strides=value.stride(),
            storage_offset=value.storage_offset(),
            dtype=value.dtype,
            device=DEVICE,
        )

    def __init__(self, value):
        self.value = value

    def tolist(self):
        return self.cpu().tolist()

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        raise RuntimeError(f"{func} on the pretended device, but it is not switched on")


class PretendedDevice(TorchDispatchMode):
    """While it is on, tensors can be on the device "meta" and have values.

    ``waits`` counts what makes the host wait, by name; ``moved`` the bytes to and from the host;
    ``unsteady`` what need not give the same again on CUDA (:func:`is_unsteady`).
    """

    def __init__(self):
        super().__init__()
        self.waits, self.moved, self.unsteady = Counter(), Counter(), Counter()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        name = func._schema.name.removeprefix("aten::")
        tensors = [x for x in tree_iter((args, kwargs)) if isinstance(x, torch.Tensor)]
        there = [x for x in tensors if isinstance(x, There)]
        if any(x.device == DEVICE and not isinstance(x, There) for x in tensors):
            raise RuntimeError(f"{name}: a tensor was made from numbers on the device, by a copy")
        wanted = kwargs.get("device")
        if not there and wanted != DEVICE:
            return func(*args, **kwargs)
        stays = bool(there) if wanted is None else wanted == DEVICE
        self._record(name, args, kwargs, tensors, stays)
        if wanted is not None:
            kwargs["device"] = torch.device("cpu")
        if name == "_to_copy":
            kwargs.pop("non_blocking", None)
        host = tree_map(lambda x: x.value if isinstance(x, There) else x, (args, kwargs))
        if is_unsteady(func, *host):
            self.unsteady[name] += 1
        result = func(*host[0], **host[1])
        if name == "copy_" or func._schema.is_mutable:
            return _changed(func, args, kwargs, result)
        if not stays:
            return result
        return tree_map(lambda x: There(x) if isinstance(x, torch.Tensor) else x, result)

    def _record(self, name, args, kwargs, tensors, stays):
        here = [x for x in tensors if not isinstance(x, There)]
        if name in COPIES:
            source = args[0] if name == "_to_copy" else args[1]
            target_there = stays if name == "_to_copy" else isinstance(args[0], There)
            if isinstance(source, There) != target_there:
                way = "to the device" if target_there else "to the host"
                if not (target_there and kwargs.get("non_blocking", False)):
                    self.waits[way] += 1
                self.moved[way] += source.numel() * source.element_size()
            return
        if name.startswith(("index", "_index_put")):
            indices = [x for x in args[1] if x is not None] if isinstance(args[1], list) else []
            single = name != "index" and args[2].numel() == 1
            if any(x.dtype in (torch.bool, torch.uint8) for x in indices) and not single:
                self.waits["index by a mask"] += 1
            if any(not isinstance(x, There) for x in indices):
                self.waits["index from the host"] += 1
            here = [x for x in here if not any(x is index for index in indices)]
        # TensorIterator takes a number from the host along; ``where`` copies it to the device.
        if any(x.ndim for x in here):
            raise RuntimeError(f"{name}: expected all tensors on one device, got both")
        if here and name == "where":
            self.waits["where with a number on the host"] += 1
        if name in LOOKS | SIZES | DECOMPOSITIONS:
            self.waits[name] += 1


def _changed(func, args, kwargs, result):
    """The arguments that were written to, in place of their values."""
    written = [
        kwargs.get(argument.name, args[i] if i < len(args) else None)
        for i, argument in enumerate(func._schema.arguments)
        if argument.alias_info is not None and argument.alias_info.is_write
    ]
    if isinstance(result, torch.Tensor):
        return written[0]
    return tuple(written) if result is not None else None


def is_unsteady(func, args, kwargs):
    """Whether an operation may give one result now and another the next time, on CUDA.

    As documented with ``torch.use_deterministic_algorithms``: numbers that are added in the order
    in which threads come by, or written to one place more than once. ``cumsum`` is of them only for
    a single row, which is divided among thread blocks (pytorch issue 75240); of more rows, each is
    added up by one.
    """
    name = func._schema.name.removeprefix("aten::").rstrip("_").removesuffix("_impl")
    first = args[0] if args and isinstance(args[0], torch.Tensor) else None
    if name in {"scatter_add", "index_add", "index_reduce", "put", "histc"}:
        return first.is_floating_point() or name == "put"
    if name in {"median", "nanmedian"}:
        return "dim" in func._overloadname  # then it tells the places, too
    if name == "scatter_reduce":
        return first.is_floating_point() and args[4] in ("sum", "mean", "prod")
    if name == "bincount":
        return len(args) > 1 and args[1] is not None
    if name == "cumsum":
        return first.is_floating_point() and first.numel() == first.shape[args[1]] > 1
    if name.removeprefix("_") == "index_put":
        indices = [x for x in args[1] if x is not None]
        if any(x.dtype == torch.bool for x in indices):
            return False
        places = torch.stack(torch.broadcast_tensors(*indices)).flatten(1)
        return len(torch.unique(places, dim=1).T) < len(places.T)
    return False


class Generator(torch.Generator):
    """In place of ``torch.Generator``: for the pretended device it is one of the CPU."""

    def __new__(cls, device="cpu"):
        return super().__new__(cls, "cpu" if torch.device(device) == DEVICE else device)
