"""The paper's Tables 5 to 9 in its own layout: its printed numbers, and ours below each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import mean, median, stdev
from typing import NamedTuple

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.tables import Table
from torchreg.benchmark.core.timing import spread
from torchreg.benchmark.paper.measure import SPANS, TIMED
from torchreg.benchmark.paper.methods import METHODS, SHORT, TITLES
from torchreg.benchmark.paper.places import PlaceGroup
from torchreg.benchmark.paper.printed import ERRORS, SECONDS
from torchreg.benchmark.paper.settings import TABLES, settings_of

LABELS = {"rre_degrees": "RRE/°", "rte_meters": "RTE/m", "rmse_meters": "RMSE/m"}

_COLUMN_NAMES = {1: "Initial pose", 3: "Point count"}
_STACKED = 3  # the experiment whose methods the paper puts one below the other

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


class PaperCell(NamedTuple):
    """One setting, group and method."""

    runs: int  # number of places
    found: int  # of these, pairs whose RMSE is below ``FOUND`` inlier thresholds
    spreads: dict[str, Spread]  # by measure


Key = tuple[int, str, str, str]
"""Experiment, setting, group and method."""

Cells = Mapping[Key, PaperCell]


def errors_of(rows: Sequence[Row]) -> list[Row]:
    """The rows of Experiments 1, 2, 3 and 5."""
    return [row for row in rows if row["experiment"] != 4]


def times_of(rows: Sequence[Row]) -> list[Row]:
    """The rows of Experiment 4."""
    return [row for row in rows if row["experiment"] == 4]


def summarize(rows: Sequence[Row]) -> dict[Key, PaperCell]:
    """Mean and spread over the places of a group, for all rows of Experiments 1, 2, 3 and 5."""
    gathered: dict[Key, list[Row]] = {}
    for row in errors_of(rows):
        gathered.setdefault((row["experiment"], row["setting"], row["group"], row["method"]), []).append(row)
    return {
        key: PaperCell(
            len(runs), sum(map(is_found, runs)), {name: spread_of([row[name] for row in runs]) for name in MEASURES}
        )
        for key, runs in gathered.items()
    }


def is_found(row: Row) -> bool:
    """Whether a registration is near enough to the truth for a refinement to do the rest."""
    return bool(row["rmse_meters"] < FOUND * row["threshold"])


def spread_of(values: Sequence[float]) -> Spread:
    """Mean, standard deviation, median and range of at least one number."""
    deviation = stdev(values) if len(values) > 1 else None
    return Spread(mean(values), deviation, median(values), min(values), max(values))


def error_table(experiment: int, group: PlaceGroup, cells: Cells, part: str = "") -> Table:
    """The paper's table of experiment 1, 2, 3 or 5, its numbers beside ours on one group of places.

    Cells that are missing are left open; ``part`` is a letter behind the number of the table.
    """
    settings = [setting.name for setting in settings_of(experiment)]
    blocks = [_block(experiment, method, settings, group, cells) for method in METHODS]
    heading = f"Table {TABLES[experiment]}{part}: {group.title}"
    column = _COLUMN_NAMES.get(experiment)
    if experiment == _STACKED:
        rows = []
        for method, block in zip(METHODS, blocks, strict=True):
            rows.append([f"**{TITLES[method]}**", *[""] * len(settings)])
            rows += block
        return Table(heading, [column or "", *settings], rows)
    gaps = [""] * (len(settings) - 1)
    head = ["", *(text for method in METHODS for text in (TITLES[method], *gaps))]
    rows = [[column, *settings * len(METHODS)]] if column else []
    for lines in zip(*blocks, strict=True):
        rows.append([lines[0][0], *(text for line in lines for text in line[1:])])
    return Table(heading, head, rows)


def overview_table(groups: Sequence[PlaceGroup], cells: Cells) -> Table:
    """The paper's RMSE of every setting, and below it, for each group, pairs found and median RMSE in meters."""
    rows = []
    for experiment in TABLES:
        for setting in settings_of(experiment):
            names = (experiment, setting.name)
            by_group = {group.name: [cells.get((*names, group.name, method)) for method in METHODS] for group in groups}
            lines = [[name, *map(_short, of_group)] for name, of_group in by_group.items() if any(of_group)]
            if lines:
                printed = [ERRORS.get((*names, method)) for method in METHODS]
                paper = ["-" if one is None else as_printed(one.rmse_meters, 3) for one in printed]
                label = f"{experiment}: pose {setting.name}" if experiment == 1 else f"{experiment}: {setting.name}"
                rows += [[label, "the paper", *paper], *(["", *line] for line in lines)]
    return Table("Overview: pairs found, median RMSE in meters", ["setting", "places", *SHORT.values()], rows)


def time_table(rows: Sequence[Row]) -> Table:
    """Table 8 from the rows of Experiment 4: medians with their range."""
    names = [setting.name for setting in settings_of(3)]
    by_name: Mapping[str, Row] = {row["setting"]: row for row in rows}
    lines = [[f"{method}, paper", *(f"{as_printed(SECONDS[name, method], 4)} s" for name in names)] for method in TIMED]
    for span in SPANS:
        for method in TIMED:
            texts = [_seconds(by_name.get(name), f"{span}/{method}") for name in names]
            lines.append([f"{method}, {span}", *texts])
        lines.append([f"added by PCFH, {span}", *(_added(by_name.get(name), span) for name in names)])
    return Table("Table 8: processing times", ["Point count", *names], lines)


def added(row: Row, span: str) -> float:
    """By what share the fused features take longer than FPFH alone: the median over rounds timed side by side."""
    one, other = (row["seconds"][f"{span}/{method}"] for method in TIMED)
    return float(median(b / a for a, b in zip(one, other, strict=True))) - 1


def added_in_words(rows: Sequence[Row]) -> str:
    """One sentence: by how much PCFH lengthens each span, over all point counts."""
    counts = [row["points"] for row in rows]
    parts = []
    for span in SPANS:
        shares = [added(row, span) for row in rows]
        parts.append(f"{min(shares):+.0%} to {max(shares):+.0%} ({span})")
    return f"PCFH adds to the time of FPFH, at {min(counts):,} to {max(counts):,} points: {', '.join(parts)}."


def as_printed(value: float, decimals: int) -> str:
    """A number of the paper with the zeros that it prints; those with more digits keep them."""
    return f"{value:.{decimals}f}" if round(value, decimals) == value else f"{value:g}"


def number(value: float) -> str:
    """Three decimals below 10, as the paper has them, one above."""
    return f"{value:.3f}" if abs(value) < 10 else f"{value:.1f}"


def _block(experiment: int, method: str, settings: Sequence[str], group: PlaceGroup, cells: Cells) -> list[list[str]]:
    """The lines of one method: a label, then one text per setting."""
    printed = [ERRORS.get((experiment, name, method)) for name in settings]
    ours = [cells.get((experiment, name, group.name, method)) for name in settings]
    lines = []
    for measure, label in LABELS.items():
        lines.append(
            [f"{label}, paper", *("-" if one is None else as_printed(getattr(one, measure), 3) for one in printed)]
        )
        lines.append([f"{label}, ours", *(_spread(cell, measure) for cell in ours)])
    lines.append(["RMSE/m, our median", *(_median(cell, "rmse_meters") for cell in ours)])
    lines.append(["found", *("-" if cell is None else f"{cell.found} / {cell.runs}" for cell in ours)])
    lines.append(["inlier ratio", *(_median(cell, "inlier_ratio") for cell in ours)])
    return lines


def _spread(cell: PaperCell | None, measure: str) -> str:
    if cell is None:
        return "-"
    one = cell.spreads[measure]
    return number(one.mean) if one.deviation is None else f"{number(one.mean)} ± {number(one.deviation)}"


def _median(cell: PaperCell | None, measure: str) -> str:
    return "-" if cell is None else number(cell.spreads[measure].median)


def _short(cell: PaperCell | None) -> str:
    return "-" if cell is None else f"{cell.found}/{cell.runs}, {_median(cell, 'rmse_meters')}"


def _seconds(row: Row | None, name: str) -> str:
    return "-" if row is None else spread(row["seconds"][name])


def _added(row: Row | None, span: str) -> str:
    return "-" if row is None else f"{added(row, span):+.0%}"
