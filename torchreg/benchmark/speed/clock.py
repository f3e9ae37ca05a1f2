"""Times of several functions in turn, within bounds of patience."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

PATIENCE = 60.0
"""Seconds for the counted runs of one function; the first one is always counted."""


def timed(runs: Mapping[str, Callable[[], Any]], repeats: int, patience: float = PATIENCE) -> dict[str, list[float]]:
    """Seconds of every function, run in turn after a warm-up of each.

    A function whose runs have taken ``patience`` seconds is not run again. One whose warm-up alone took that long is
    not run again either: its warm-up is what counts.
    """
    found: dict[str, list[float]] = {}
    for name, run in runs.items():
        first = _seconds(run)
        found[name] = [first] if first > patience else []
    for _ in range(repeats):
        for name, run in runs.items():
            if not found[name] or sum(found[name]) < patience:
                found[name].append(_seconds(run))
    return found


def _seconds(run: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin
