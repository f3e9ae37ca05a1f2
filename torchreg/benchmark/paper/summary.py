"""Mean and spread over the places of a group."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from statistics import mean, median, stdev
from typing import NamedTuple

from torchreg.benchmark.rows import Row

MEASURES = ("rre_degrees", "rte_meters", "rmse_meters", "inlier_ratio")
"""The paper's Eq. (5) to (7), and the share of matches that the true motion brings within the inlier threshold."""

FOUND = 2.5
"""A pair counts as found when its RMSE is below so many inlier thresholds: 0.5 m at the paper's 0.2 m."""


class Spread(NamedTuple):
    """One measure over several places; the standard deviation of one alone is ``None``."""

    mean: float
    deviation: float | None
    median: float
    least: float
    most: float


class Cell(NamedTuple):
    """One setting, group and method.

    Attributes:
        runs: how many places.
        found: of these, pairs whose RMSE is below ``FOUND`` inlier thresholds.
        spreads: by measure.
    """

    runs: int
    found: int
    spreads: dict[str, Spread]


Key = tuple[int, str, str, str]
"""Experiment, setting, group and method."""


def summarize(rows: Iterable[Row]) -> dict[Key, Cell]:
    """The cells of all rows of Experiments 1, 2, 3 and 5."""
    gathered: dict[Key, list[Row]] = {}
    for row in rows:
        gathered.setdefault((row["experiment"], row["setting"], row["group"], row["method"]), []).append(row)
    return {
        key: Cell(len(own), sum(map(found, own)), {name: spread_of([row[name] for row in own]) for name in MEASURES})
        for key, own in gathered.items()
    }


def found(row: Row) -> bool:
    """Whether a registration came near enough to the truth that a refinement would do the rest."""
    return bool(row["rmse_meters"] < FOUND * row["threshold"])


def spread_of(values: Sequence[float]) -> Spread:
    """Mean, standard deviation, median and range of at least one number."""
    deviation = stdev(values) if len(values) > 1 else None
    return Spread(mean(values), deviation, median(values), min(values), max(values))
