"""Times that can be compared: warmed up, taken in turn in one process, medians with their spread."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Any


def interleaved(
    runs: Mapping[str, Callable[[], Any]], repeats: int = 5, *, patience: float = math.inf
) -> dict[str, list[float]]:
    """Seconds of several functions run in turn after a warm-up of each, so that drift hits all alike.

    A function whose counted runs have taken ``patience`` seconds is not run again. Where its warm-up alone took that
    long, the warm-up is what counts.
    """
    seconds: dict[str, list[float]] = {}
    for name, run in runs.items():
        first = seconds_of(run)
        seconds[name] = [first] if first > patience else []
    for _ in range(repeats):
        for name, run in runs.items():
            if sum(seconds[name]) < patience:
                seconds[name].append(seconds_of(run))
    return seconds


def spread(seconds: Sequence[float]) -> str:
    """Median and range, in the unit that fits."""
    scale, unit = (1e3, "ms") if median(seconds) < 1 else (1.0, "s")
    if len(seconds) == 1:
        return f"{seconds[0] * scale:.3g} {unit} (once)"
    return f"{median(seconds) * scale:.3g} {unit} ({min(seconds) * scale:.3g} to {max(seconds) * scale:.3g})"


def seconds_of(run: Callable[[], Any]) -> float:
    """Wall-clock seconds of one run."""
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin
