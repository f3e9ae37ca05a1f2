"""What the program is doing, for someone who waits."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from torchreg.report.text import plain


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
