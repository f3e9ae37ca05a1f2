"""What a command is doing, for someone who waits: on standard error, apart from results."""

from __future__ import annotations

import sys
import threading
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
from torchreg.site import SiteProgress

_SECONDS_BETWEEN_LINES = 10.0
_SILENT_SECONDS, _SHORT_STEP = 2.0, 1.0  # of the command, of a step: before these nothing is said off a terminal
_BEGIN = time.monotonic()
_WORDS = {
    "measure": ("measuring", "clouds"),
    "look": ("reading", "files"),
    "compare": ("comparing", "pairs"),
    "describe": ("describing", "clouds"),
    "register": ("registering", "pairs"),
    "place": ("placing", "scans"),
    "refine": ("refining", "pairs"),
    "train": ("training", "steps"),
    "judge": ("judging", "pairs"),
}

WorkProgress = BatchProgress | SiteProgress


@contextmanager
def step(what: str, *, at_once: bool = False) -> Iterator[None]:
    """Name a long step on standard error: beside a turning mark and its seconds where that is a terminal.

    There the line goes away when the step ends. Elsewhere, such as in a log, the step is named on a line of its own
    once it has taken a while and the command has been at work for two seconds, or ``at_once``. Standard output is
    not touched.
    """
    if not sys.stderr.isatty():
        with _named_when_long(what, at_once=at_once):
            yield
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        progress.add_task(plain(what).plain)
        yield


@contextmanager
def _named_when_long(what: str, *, at_once: bool = False) -> Iterator[None]:
    if at_once:
        complain(what)
        yield
        return
    wait = max(_SILENT_SECONDS - (time.monotonic() - _BEGIN), _SHORT_STEP)
    timer = threading.Timer(wait, complain, [what])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()


@contextmanager
def reading_bar(name: str) -> Iterator[Callable[[int, int | None], None] | None]:
    """A function that shows how many points of a file were read, and how many a second; ``None`` off a terminal.

    The bar goes away at the end. Files that are read as a whole show a turning mark and the seconds. Off a terminal
    this is a ``step``.
    """
    if not sys.stderr.isatty():
        with _named_when_long(f"reading {name}"):
            yield None
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[rate]}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        task, begin = bars.add_task(plain(f"reading {name}").plain, total=None, rate=""), time.monotonic()

        def show(read: int, rows: int | None) -> None:
            bars.update(task, completed=read, total=rows, rate=points_rate(read, time.monotonic() - begin))

        yield show


def points_rate(points: int, seconds: float) -> str:
    """Points and points a second in words, such as "3.2 million points, 1.1 million/s"."""
    rate = f", {_millions(points / seconds)}/s" if seconds > 0 else ""
    return f"{_millions(points)} points{rate}"


def _millions(count: float) -> str:
    return f"{count / 1e6:.1f} million" if count >= 1e6 else f"{count:,.0f}"


@contextmanager
def batch_progress() -> Iterator[Callable[[WorkProgress], None]]:
    """A function that shows every step of long work: as bars on a terminal, as a line now and then elsewhere."""
    if not sys.stderr.isatty():
        yield _lines()
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        pace = _Pace()
        tasks: dict[str, TaskID] = {}

        def show(progress: WorkProgress) -> None:
            if progress.stage not in tasks:
                tasks[progress.stage] = bars.add_task(" ".join(_WORDS[progress.stage]), total=progress.total, rate="")
            rate = pace.words(progress)
            bars.update(tasks[progress.stage], completed=progress.done, total=progress.total, rate=rate)

        yield show


def _lines() -> Callable[[WorkProgress], None]:
    """A function that prints a line every few seconds, and one where a stage begins and ends."""
    pace, last, stage = _Pace(), 0.0, ""

    def show(progress: WorkProgress) -> None:
        nonlocal last, stage
        words, now = pace.words(progress), time.monotonic()
        soon = now - last < _SECONDS_BETWEEN_LINES and progress.stage == stage
        if progress.total == 0 or (soon and progress.done < progress.total):
            return
        last, stage = now, progress.stage
        doing, what = _WORDS[progress.stage]
        complain(f"{doing} {what}: {progress.done:,} of {progress.total:,}{f', {words}' if words else ''}")

    return show


class _Pace:
    """How fast the stages of this run are."""

    def __init__(self) -> None:
        self._begun: dict[str, tuple[float, int]] = {}  # seconds, and items done before this run, by stage

    def words(self, now: WorkProgress) -> str:
        """Rate, time left and failures, where there are any."""
        begin, before = self._begun.setdefault(now.stage, (time.monotonic(), now.done))
        spent, done = time.monotonic() - begin, now.done - before
        failed = f", {now.failed:,} not registered" if now.failed else ""
        if done == 0 or spent <= 0:
            return failed.removeprefix(", ")
        rate = done / spent
        left = f", {(now.total - now.done) / rate:.0f} s left" if now.done < now.total else ""
        return f"{rate:{'.0f' if rate >= 10 else '.2g'}} {_WORDS[now.stage][1]}/s{left}{failed}"
