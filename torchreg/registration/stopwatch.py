"""Times of the stages of one run, counted beside the code that runs them."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_running: ContextVar[dict[str, float] | None] = ContextVar("stages", default=None)


@contextmanager
def stopwatch() -> Iterator[dict[str, float]]:
    """Collect the wall-clock seconds of every stage called within, by name, in the order of their first calls."""
    seconds: dict[str, float] = {}
    before = _running.set(seconds)
    try:
        yield seconds
    finally:
        _running.reset(before)


def stage(name: str) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Count the time of a function under this name, where a ``stopwatch`` runs. Stages must not call each other."""

    def decorate(run: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        @functools.wraps(run)
        def timed(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
            seconds, begin = _running.get(), time.perf_counter()
            try:
                return run(*args, **kwargs)
            finally:
                if seconds is not None:
                    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - begin

        return timed

    return decorate
