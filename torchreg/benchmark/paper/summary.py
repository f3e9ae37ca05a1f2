"""Mean and spread over the places of a group."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from statistics import mean, median, stdev
from typing import NamedTuple

from torchreg.benchmark.paper.rows import Row

MEASURES = ("rre_degrees", "rte_meters", "rmse_meters", "inlier_ratio")
"""The paper's Eq. (5) to (7), and the share of matches that the true motion brings within the inlier threshold."""

ROTATION_BOUND = 15.0
TRANSLATION_BOUND = 0.3
"""Degrees and meters: below both, a pair counts as found; of scans with a threshold above 0.2 m, 1.5 times that."""


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
        found: of these, pairs with a rotation and a translation error below the bounds.
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
    bound = max(TRANSLATION_BOUND, 1.5 * row["threshold"])
    return bool(row["rre_degrees"] < ROTATION_BOUND and row["rte_meters"] < bound)


def spread_of(values: Sequence[float]) -> Spread:
    """Mean, standard deviation, median and range of at least one number."""
    deviation = stdev(values) if len(values) > 1 else None
    return Spread(mean(values), deviation, median(values), min(values), max(values))
