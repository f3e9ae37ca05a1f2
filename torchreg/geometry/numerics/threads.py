"""Parts of one task shared among threads, each of which uses one core or a few."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from contextvars import copy_context
from typing import TypeVar

from torch import Tensor

from torchreg.native import kernel_threads, native, torch_on_one_thread

Part = TypeVar("Part")
Done = TypeVar("Done")


def shared_out(run: Callable[[Part], Done], parts: Sequence[Part], workers: int) -> list[Done]:
    """The results of ``run`` for every part, in order, computed by ``workers`` threads at most.

    While they work, torch uses one thread in an operation: threads within threads would wait for cores, and small
    operations for the threads. Kernels share what threads there are.
    """
    workers = max(1, min(workers, len(parts)))
    each = max(1, kernel_threads() // workers)

    def work(part: Part) -> Done:
        with torch_on_one_thread(each):
            return run(part)

    if workers == 1:
        return [work(part) for part in parts]
    contexts = [copy_context() for _ in parts]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(lambda context, part: context.run(work, part), contexts, parts))


def undisturbed(tensor: Tensor) -> AbstractContextManager[None]:
    """A context in which torch uses one thread where compiled kernels do the large part of the work on such tensors.

    So no operation waits for a thread whose core another program keeps busy.
    """
    return torch_on_one_thread() if native(tensor) else nullcontext()
