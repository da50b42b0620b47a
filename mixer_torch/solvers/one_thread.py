"""Small matrices are for one thread: what two save is less than their waiting for each other."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


def one_thread() -> AbstractContextManager[Any]:
    """A context in which the calling thread computes alone.

    OpenMP's threads wait for each other by spinning, many times in each step; where another process
    holds a core, each time until that is descheduled, which takes a hundred times longer than the
    work. The limit is that of the calling thread: other threads keep theirs. It does not reach
    what ``torch.set_num_threads`` has been told before.
    """
    return _controller().limit(limits=1, user_api="openmp")


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()
