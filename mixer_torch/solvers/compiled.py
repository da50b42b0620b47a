"""Compiled kernels: the decorator that all of them share, and their random numbers.

numba is imported where the first kernel is used: it takes a third as long as torch to import.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache, cached_property, update_wrapper
from inspect import unwrap
from pathlib import Path
from types import CellType, FunctionType
from typing import Any

import numpy as np

# "No node" or "no slot": an int64, because a plain -1 would be a type of its own to numba.
NONE: Any = np.int64(-1)
# Of splitmix64 (Steele, Lea, Flood, OOPSLA 2014): the increment of the state, which is 2^64 over
# the golden ratio, and the factors of the finaliser.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_HALF = np.uint64(32)  # bits of a hash that a draw uses
_INNER = {
    "_nrt": False,  # arrays are not counted: they belong to the kernel that calls
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "forceinline": True,
}


@cache
def _version() -> str:
    """A hash of all sources with kernels.

    Machine code is kept with the code of the kernels that a kernel calls built in, but numba looks
    only at the kernel's own file to see whether it is still good.
    """
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        text = path.read_bytes()
        if any(b"@" + name in text for name in (b"compiled", b"inner", b"vectorised")):
            digest.update(text)
    return digest.hexdigest()


def compiled(function: Callable[..., Any]) -> Any:
    """Compile when first called, and keep the machine code on disk where there is room for it."""
    return Kernel(function, {})


def inner(function: Callable[..., Any]) -> Any:
    """A function that makes no array and is compiled into the kernels that call it.

    A call would pass every field of every array of a state, a hundred values and more, through
    memory: that took longer than what most of these functions do.
    """
    return Kernel(function, _INNER)


def vectorised(function: Callable[..., Any]) -> Any:
    """As :func:`inner`, and sums may be taken in any order: several entries at a time.

    The order is fixed in the machine code, so the same input gives the same sum. Entries must be
    finite.
    """
    fastmath = {"reassoc", "nsz", "nnan", "contract"}
    return Kernel(function, {"fastmath": fastmath, **_INNER})


class Kernel:
    """A function that is compiled when it is first used, by Python or by another kernel.

    Args:
        function: The function in Python.
        options: Of ``numba.njit``.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self.function = unwrap(function)  # from the checks of shapes while tests run
        self.options = {"nogil": True, "error_model": "numpy", **options}
        update_wrapper(self, self.function)

    def __call__(self, *args: Any) -> Any:
        return self.dispatcher(*args)

    @cached_property
    def dispatcher(self) -> Any:
        """What numba makes of the function."""
        import numba

        versioned = _versioned(self.function)
        try:
            return numba.njit(cache=True, **self.options)(versioned)
        except RuntimeError:  # numba finds no folder that it may write to
            return numba.njit(**self.options)(versioned)

    @property
    def _numba_type_(self) -> Any:
        """The attribute by which numba knows what a global name in another kernel stands for."""
        return self.dispatcher._numba_type_


def _versioned(function: Callable[..., Any]) -> FunctionType:
    """The function with the version of all kernels' sources as a closure variable.

    numba makes closure variables part of the key under which it keeps the machine code.
    """
    code = function.__code__
    code = code.replace(co_freevars=(*code.co_freevars, "_version"))
    closure = (*(function.__closure__ or ()), CellType(_version()))
    versioned = FunctionType(code, function.__globals__, function.__name__, None, closure)
    update_wrapper(versioned, function)
    del versioned.__wrapped__  # type: ignore[attr-defined]
    return versioned


@inner
def mix(value: np.uint64) -> np.uint64:
    """A hash of 64 bits (the finaliser of splitmix64; Steele, Lea, Flood, OOPSLA 2014)."""
    value = (value ^ (value >> np.uint64(30))) * _MIX_1
    value = (value ^ (value >> np.uint64(27))) * _MIX_2
    return value ^ (value >> np.uint64(31))


@inner
def draw(state: np.ndarray, bound: int) -> np.int64:
    """A random integer in 0..bound-1 < 2^32; the state is (1,) uint64 and moves on by one step."""
    state[0] += _GOLDEN
    return np.int64(((mix(state[0]) >> _HALF) * np.uint64(bound)) >> _HALF)


@inner
def shuffle(state: np.ndarray, items: np.ndarray, count: int) -> None:
    """Put the first count items in random order, in place."""
    for i in range(count - 1, 0, -1):
        j = draw(state, i + 1)
        items[i], items[j] = items[j], items[i]
