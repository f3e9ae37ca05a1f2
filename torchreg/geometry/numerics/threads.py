"""Parts of one task shared among threads, each of which uses one core."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

Part = TypeVar("Part")
Done = TypeVar("Done")


def shared_out(run: Callable[[Part], Done], parts: Sequence[Part], workers: int) -> list[Done]:
    """The results of ``run`` for every part, in order, computed by ``workers`` threads at most.

    While they work, torch uses one thread in an operation: threads within threads would wait for cores, and small
    operations for the threads.
    """
    workers, threads = min(workers, len(parts)), torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        if workers <= 1:
            return [run(part) for part in parts]
        with ThreadPoolExecutor(workers) as pool:
            return list(pool.map(run, parts))
    finally:
        torch.set_num_threads(threads)
