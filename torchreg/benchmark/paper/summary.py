"""Rows summed up over places: the share of runs found, median errors, and what color changes, place by place.

Runs of RANSAC on one place see the same points, so places are resampled, not runs: the share of its runs that are
found and the median of their errors stand for a place. Methods are compared on the same places, by the differences of
these two numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from statistics import mean, median, stdev
from typing import NamedTuple

from torchreg.benchmark.core import bootstrap
from torchreg.benchmark.core.bootstrap import Interval, Statistic
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.paper.methods import METHODS
from torchreg.benchmark.paper.places import GROUPS
from torchreg.benchmark.paper.printed import FPFH
from torchreg.benchmark.paper.settings import SETTINGS
from torchreg.benchmark.paper.ways import WAYS

MEASURES = ("rre_degrees", "rte_meters", "rmse_meters", "inlier_ratio")
"""The paper's Eq. (5) to (7), and the share of matches that the true motion brings within the inlier threshold."""

FOUND = 2.5
"""A pair counts as found when its RMSE is below so many inlier thresholds: 0.5 m at the paper's 0.2 m."""

LEAST_PLACES = 6
"""Fewer places decide nothing: five that agree do so by chance once in sixteen times."""


class Spread(NamedTuple):
    """One measure over several places; the standard deviation of one alone is ``None``."""

    mean: float
    deviation: float | None
    median: float
    least: float
    most: float


class Key(NamedTuple):
    """What one cell of a table is about."""

    experiment: int
    setting: str
    group: str
    way: str
    method: str


class PaperCell(NamedTuple):
    """One setting, group, way and method."""

    places: int  # how many
    found: Interval  # share of runs whose RMSE is below ``FOUND`` inlier thresholds, mean over places
    rmse: Interval  # meters, median over places
    spreads: dict[str, Spread]  # by measure, over places


class Difference(NamedTuple):
    """What a method changes against FPFH alone on the same places."""

    places: int  # how many
    found: Interval  # share of runs found: the mean of the differences
    rmse: Interval  # meters: the median of the differences

    @property
    def found_verdict(self) -> str:
        """``"better"``, ``"worse"`` or ``"undecided"``, by the share found."""
        return _verdict(self.places, self.found.low, self.found.high)

    @property
    def rmse_verdict(self) -> str:
        """The same by the RMSE, which is better below zero."""
        return _verdict(self.places, -self.rmse.high, -self.rmse.low)


Cells = Mapping[Key, PaperCell]
Differences = Mapping[Key, Difference]


def errors_of(rows: Sequence[Row]) -> list[Row]:
    """The rows of Experiments 1, 2, 3 and 5."""
    return [row for row in rows if row["experiment"] != 4]


def times_of(rows: Sequence[Row]) -> list[Row]:
    """The rows of Experiment 4."""
    return [row for row in rows if row["experiment"] == 4]


def summarize(rows: Sequence[Row]) -> dict[Key, PaperCell]:
    """Every cell of Experiments 1, 2, 3 and 5, in the order of the paper."""
    return {
        key: PaperCell(
            len(places),
            _interval(tuple(map(found_share, places)), bootstrap.mean),
            _interval(tuple(error(row, "rmse_meters") for row in places), bootstrap.median),
            {name: spread_of([error(row, name) for row in places]) for name in MEASURES},
        )
        for key, places in _gathered(rows).items()
    }


def differences_of(rows: Sequence[Row]) -> dict[Key, Difference]:
    """What every method but FPFH changes against it, over the places that have rows of both."""
    gathered = _gathered(rows)
    made = {}
    for key, places in gathered.items():
        alone = {row["place"]: row for row in gathered.get(key._replace(method=FPFH), [])}
        pairs = [(row, alone[row["place"]]) for row in places if row["place"] in alone]
        if key.method != FPFH and pairs:
            found = tuple(found_share(one) - found_share(other) for one, other in pairs)
            rmse = tuple(error(one, "rmse_meters") - error(other, "rmse_meters") for one, other in pairs)
            made[key] = Difference(len(pairs), _interval(found, bootstrap.mean), _interval(rmse, bootstrap.median))
    return made


def found_share(row: Row) -> float:
    """The share of a place's runs that come near enough to the truth for a refinement to do the rest."""
    return mean(float(rmse < FOUND * row["threshold"]) for rmse in row["rmse_meters"])


def error(row: Row, measure: str) -> float:
    """One of ``MEASURES`` of a place: the median of its runs where they differ."""
    value = row[measure]
    return float(median(value)) if isinstance(value, list) else float(value)


def spread_of(values: Sequence[float]) -> Spread:
    """Mean, standard deviation, median and range of at least one number."""
    deviation = stdev(values) if len(values) > 1 else None
    return Spread(mean(values), deviation, median(values), min(values), max(values))


def _gathered(rows: Sequence[Row]) -> dict[Key, list[Row]]:
    """The rows of every cell that has some, one per place; cells in the order of settings, groups, ways and methods."""
    found: dict[Key, list[Row]] = {}
    for row in errors_of(rows):
        found.setdefault(Key(*(row[name] for name in Key._fields)), []).append(row)
    every = (
        Key(setting.experiment, setting.name, group.name, way.name, method)
        for setting in SETTINGS
        for group in GROUPS
        for way in WAYS
        for method in METHODS
    )
    return {key: found[key] for key in every if key in found}


@cache  # all files of a run ask for the same ones
def _interval(values: tuple[float, ...], statistic: Statistic) -> Interval:
    return bootstrap.bootstrap(values, statistic)


def _verdict(places: int, low: float, high: float) -> str:
    """What an interval of a gain says."""
    if places < LEAST_PLACES or low <= 0 <= high:
        return "undecided"
    return "better" if low > 0 else "worse"
