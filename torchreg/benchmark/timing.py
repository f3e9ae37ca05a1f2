"""Times that can be compared: warmed up, taken in turn in one process, medians with their spread."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Any


def interleaved(runs: Mapping[str, Callable[[], Any]], repeats: int = 5) -> dict[str, list[float]]:
    """Seconds of several functions run in turn after a warm-up of each, so that drift hits all alike."""
    for run in runs.values():
        run()
    found: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            begin = time.perf_counter()
            run()
            found[name].append(time.perf_counter() - begin)
    return found


def spread(seconds: Sequence[float]) -> str:
    """Median and range, in the unit that fits."""
    scale, unit = (1e3, "ms") if median(seconds) < 1 else (1.0, "s")
    return f"{median(seconds) * scale:.3g} {unit} ({min(seconds) * scale:.3g} to {max(seconds) * scale:.3g})"
