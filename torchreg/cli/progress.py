"""What a command is doing, for someone who waits: on standard error, apart from results."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from torchreg.batch import BatchProgress
from torchreg.cli.guard import complain
from torchreg.report.text import plain

_SECONDS_BETWEEN_LINES = 10.0
_WORDS = {
    "measure": ("measuring", "clouds"),
    "describe": ("describing", "clouds"),
    "register": ("registering", "pairs"),
}


@contextmanager
def step(what: str) -> Iterator[None]:
    """Name a long step beside a turning mark and its seconds, on standard error where that is a terminal.

    The line goes away when the step ends; standard output is not touched.
    """
    if not sys.stderr.isatty():
        yield
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        progress.add_task(plain(what).plain)
        yield


@contextmanager
def batch_progress() -> Iterator[Callable[[BatchProgress], None]]:
    """A function that shows every step of a batch: as bars on a terminal, as a line now and then elsewhere."""
    if not sys.stderr.isatty():
        yield _Lines()
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        yield _Bars(bar)


class _Pace:
    """How fast a stage of this run is."""

    def __init__(self, first: BatchProgress) -> None:
        self._first, self._begin = first, time.monotonic()

    def words(self, now: BatchProgress) -> str:
        """Rate, time left and failures, where there are any."""
        spent, done = time.monotonic() - self._begin, now.done - self._first.done
        failed = f", {now.failed:,} not registered" if now.failed else ""
        if done == 0 or spent <= 0:
            return failed.removeprefix(", ")
        rate = done / spent
        left = f", {(now.total - now.done) / rate:.0f} s left" if now.done < now.total else ""
        return f"{rate:{'.0f' if rate >= 10 else '.2g'}} {_WORDS[now.stage][1]}/s{left}{failed}"


class _Lines:
    def __init__(self) -> None:
        self._pace: dict[str, _Pace] = {}
        self._last = 0.0

    def __call__(self, progress: BatchProgress) -> None:
        pace = self._pace.setdefault(progress.stage, _Pace(progress))
        now = time.monotonic()
        if progress.total == 0 or (now - self._last < _SECONDS_BETWEEN_LINES and progress.done < progress.total):
            return
        self._last = now
        doing, what = _WORDS[progress.stage]
        words = pace.words(progress)
        complain(f"{doing} {what}: {progress.done:,} of {progress.total:,}{f', {words}' if words else ''}")


class _Bars:
    def __init__(self, bar: Progress) -> None:
        self._bar = bar
        self._tasks: dict[str, tuple[TaskID, _Pace]] = {}

    def __call__(self, progress: BatchProgress) -> None:
        if progress.stage not in self._tasks:
            name = " ".join(_WORDS[progress.stage])
            self._tasks[progress.stage] = (self._bar.add_task(name, total=progress.total, rate=""), _Pace(progress))
        task, pace = self._tasks[progress.stage]
        rate = pace.words(progress)
        self._bar.update(task, completed=progress.done, total=progress.total, rate=rate)
