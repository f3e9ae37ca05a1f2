"""Times of the stages of one run."""

from __future__ import annotations

import time


class Stopwatch:
    """Measures wall-clock seconds from lap to lap; laps of the same name add up."""

    def __init__(self) -> None:
        self._started = time.perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """Count the seconds since the last lap under this name."""
        now = time.perf_counter()
        self._laps[name] = self._laps.get(name, 0.0) + now - self._started
        self._started = now

    def laps(self) -> tuple[tuple[str, float], ...]:
        """(name, seconds), in the order in which the names came first."""
        return tuple(self._laps.items())
