"""How far a batch is: a bar on a terminal, now and then a line elsewhere; on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from torchreg.cli.guard import complain

if TYPE_CHECKING:
    from torchreg.batch.progress import Progress

_EVERY = 10.0  # seconds between lines
_WORDS = {"look": ("looking at", "clouds"), "describe": ("describing", "clouds"), "register": ("registering", "pairs")}


@contextmanager
def shown() -> Iterator[Callable[[Progress], None]]:
    """What to tell of every step, so that it is shown."""
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
    with Bar(*columns, console=Console(stderr=True)) as bar:
        yield _Bars(bar)


class _Pace:
    """How fast a stage goes, of what is done in this run."""

    def __init__(self, first: Progress) -> None:
        self._first, self._begin = first, time.monotonic()

    def words(self, now: Progress) -> str:
        """Rate and failures; with what is left, where something is."""
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

    def __call__(self, progress: Progress) -> None:
        pace = self._pace.setdefault(progress.stage, _Pace(progress))
        now = time.monotonic()
        if progress.total == 0 or (now - self._last < _EVERY and progress.done < progress.total):
            return
        self._last = now
        doing, what = _WORDS[progress.stage]
        words = pace.words(progress)
        complain(f"{doing} {what}: {progress.done:,} of {progress.total:,}{f', {words}' if words else ''}")


class _Bars:
    def __init__(self, bar: Bar) -> None:
        self._bar = bar
        self._tasks: dict[str, tuple[TaskID, _Pace]] = {}

    def __call__(self, progress: Progress) -> None:
        if progress.stage not in self._tasks:
            name = " ".join(_WORDS[progress.stage])
            self._tasks[progress.stage] = (self._bar.add_task(name, total=progress.total, rate=""), _Pace(progress))
        task, pace = self._tasks[progress.stage]
        rate = pace.words(progress)
        self._bar.update(task, completed=progress.done, total=progress.total, rate=rate)
