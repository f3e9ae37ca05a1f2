"""How many threads work: kernels take what the user gave torch, and torch itself one while they do.

Torch splits an operation among threads that wait for each other at its end. Where another program keeps a core busy,
each of some thousand small operations waits for the slowest thread: a pair that takes 0.4 s then takes 10. Kernels hand
out small pieces of work instead, so that a busy core delays one piece.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

import torch

_CGROUP = Path("/sys/fs/cgroup")
_kernels: ContextVar[int | None] = ContextVar("kernel_threads", default=None)


def kernel_threads() -> int:
    """The threads of a kernel called here: torch's number, but no more than the container may use."""
    given = _kernels.get()
    return given if given is not None else max(1, min(torch.get_num_threads(), _quota()))


@contextmanager
def torch_on_one_thread(kernels: int | None = None) -> Iterator[None]:
    """Within this context torch uses one thread in an operation, and kernels ``kernels``: by default as many as before.

    It holds for the thread that enters it alone.
    """
    threads = torch.get_num_threads()
    token = _kernels.set(kernel_threads() if kernels is None else kernels)
    try:
        torch.set_num_threads(1)
        yield
    finally:
        torch.set_num_threads(threads)
        _kernels.reset(token)


@functools.cache
def _quota() -> int:
    return quota(_CGROUP)


def quota(folder: Path) -> int:
    """The cores that this process may keep busy by the limits of its container, version 1 or 2, and by its affinity."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for names in (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us")):
        try:
            share, period, *_ = " ".join((folder / name).read_text() for name in names).split()
            if int(share) > 0:
                return max(1, min(cores, math.ceil(int(share) / int(period))))
        except (OSError, ValueError):  # no such file, or "max": no limit
            continue
    return cores
