"""Times of the stages of one run."""

from __future__ import annotations

import time


class Stopwatch:
    """Measures wall-clock seconds from lap to lap."""

    def __init__(self) -> None:
        self._started = time.perf_counter()
        self._laps: list[tuple[str, float]] = []

    def lap(self, name: str) -> None:
        """Note the seconds since the last lap under this name."""
        now = time.perf_counter()
        self._laps.append((name, now - self._started))
        self._started = now

    def laps(self) -> tuple[tuple[str, float], ...]:
        """(name, seconds) in order."""
        return tuple(self._laps)
