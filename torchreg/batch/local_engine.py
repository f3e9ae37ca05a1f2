"""The batch engine of one machine: a ``DataLoader`` whose workers read clouds and, on the CPU, compute too.

Reading overlaps with computing, since the workers are not at the same step at the same time; results come as they are
ready. For a GPU the workers load and this process computes. Processes rather than threads: on small clouds most of
the time goes into the interpreter, which threads share (measured on two cores, pairs of 1,000 and of 8,000 points: two
threads no faster than one, two processes twice as fast).
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import multiprocessing.forkserver
import os
import signal
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import torch
from torch.utils.data import DataLoader, Dataset

from torchreg.arguments import checked
from torchreg.batch.engine import Job, Outcome, attempt, load_and_compute
from torchreg.errors import at_least

_DEATHS = 3  # that one item may cause, alone
_PAUSE = 0.5  # seconds until a process that was killed is gone, so that another takes its place
_AHEAD = 2  # items in progress or handed over, for every worker
_GUARD = 'a script that calls this needs its own part below if __name__ == "__main__"'
_DIED = "the process that worked on it ended unexpectedly each time, out of memory or killed"


class LocalEngine:
    """Processes of this machine.

    Args:
        workers: processes; 0 works in this one.
        device: where to compute.

    Example:
        >>> from torchreg.batch import LocalEngine
        >>> LocalEngine(workers=0).close()
    """

    @checked
    def __init__(self, workers: int | None = None, device: str = "cpu") -> None:
        self._processes = cores() if workers is None else at_least(workers, "workers", 0)
        self.device = device
        self._in_workers = torch.device(device).type == "cpu"

    @property
    def workers(self) -> int:
        """How many items are worked on at once."""
        return max(1, self._processes)

    def close(self) -> None:
        """Do nothing: workers end with each job."""

    def run(self, job: Job, items: Sequence[Any]) -> Iterator[tuple[int, Outcome]]:
        """As ``Engine``'s."""
        pending, deaths = dict(enumerate(items)), 0  # deaths of the first of them, alone
        lost, done = 0, False
        suspects: list[int] = []  # perhaps in progress when a process died: each runs alone, then all together
        while pending:
            places = suspects or list(pending)
            try:
                for place, outcome in self._some(job, [(k, items[k]) for k in places], alone=bool(suspects)):
                    del pending[place]
                    deaths, done = 0, True
                    yield place, outcome
                suspects = []
            except (RuntimeError, EOFError, ConnectionError) as error:
                # the latter two: the server of processes itself is gone; it is started again
                if isinstance(error, RuntimeError) and "DataLoader worker" not in str(error):
                    raise
                time.sleep(_PAUSE)
                deaths += bool(suspects)
                suspects = [k for k in suspects if k in pending] or list(pending)[: _AHEAD * self.workers]
                if deaths == _DEATHS:
                    place, deaths, lost = suspects.pop(0), 0, lost + 1
                    del pending[place]
                    if lost > 1 and not done:
                        raise OSError(f"no process can do any work: {_DIED}; {_GUARD} ({error})") from None
                    yield place, Outcome(None, f"{_DIED} ({error})", expected=False)

    def _some(self, job: Job, items: list[tuple[int, Any]], *, alone: bool) -> Iterator[tuple[int, Outcome]]:
        do = partial(load_and_compute, job, self.device) if self._in_workers else partial(attempt, job.load)
        processes = min(self._processes, 1 if alone else len(items))
        given = dict(items)
        for place, outcome in _loaded(do, items, processes):
            if self._in_workers or outcome.reason:
                yield place, outcome
            else:
                made = attempt(job.compute, given[place], outcome.value, self.device)
                yield place, made._replace(seconds=outcome.seconds + made.seconds)


class _Work(Dataset[tuple[int, Outcome]]):
    """A data set whose sampler hands over the items themselves, so that workers hold those in progress and not all."""

    def __init__(self, do: Any) -> None:  # noqa: ANN401
        self._do = do

    def __getitem__(self, item: Any) -> tuple[int, Outcome]:  # noqa: ANN401
        place, content = item
        return place, self._do(content)


def _loaded(do: Any, items: list[tuple[int, Any]], processes: int) -> Iterator[tuple[int, Outcome]]:  # noqa: ANN401
    """Work on every item once, in that many processes; yield the outcomes as they are ready."""
    work = _Work(do)
    if processes == 0:
        yield from map(work.__getitem__, items)
        return
    with warnings.catch_warnings():  # more processes than cores are right where reading is slow
        warnings.filterwarnings("ignore", message="This DataLoader will create")
        loader = DataLoader(
            work,
            batch_size=None,  # an item is a unit of work already
            sampler=items,
            collate_fn=_as_it_is,
            num_workers=processes,
            prefetch_factor=1,
            in_order=False,
            worker_init_fn=partial(_begin_worker, max(1, cores() // processes)),
            multiprocessing_context=_context(),
        )
        ready = iter(loader)
    yield from ready


def _as_it_is(item: Any) -> Any:  # noqa: ANN401
    return item


def _begin_worker(threads: int, number: int) -> None:
    torch.set_num_threads(threads)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this worker when the process that began it is gone, however that came about.

    The watch of a ``DataLoader`` worker compares the number of its parent; with a server of processes in between, that
    number stays as long as there are workers.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)


def _context() -> Any:  # noqa: ANN401
    """Processes that begin clean of this one's threads; where it can be, from a server that has imported all once."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["torchreg.batch.preload"])
    # An interrupt goes to all processes of a terminal: this one ends the others, which ignore it.
    if threading.current_thread() is threading.main_thread():
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            multiprocessing.forkserver.ensure_running()
        finally:
            signal.signal(signal.SIGINT, before)
    return context


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
