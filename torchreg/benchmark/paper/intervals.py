"""The experiments as intervals: shares found and median errors, and what color changes on the same places."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from torchreg.benchmark.core.bootstrap import Interval
from torchreg.benchmark.core.tables import Table, csv_table
from torchreg.benchmark.paper.methods import METHODS, SHORT
from torchreg.benchmark.paper.places import PlaceGroup
from torchreg.benchmark.paper.printed import ERRORS, FPFH
from torchreg.benchmark.paper.settings import TABLES, PaperSetting, settings_of
from torchreg.benchmark.paper.summary import Cells, Difference, Differences, Key, PaperCell
from torchreg.benchmark.paper.tables import as_printed, number
from torchreg.benchmark.paper.ways import Procedure

COMPARED = tuple(method for method in METHODS if method != FPFH)
"""The methods that are compared with FPFH alone."""


def overview_table(groups: Sequence[PlaceGroup], ways: Sequence[Procedure], cells: Cells) -> Table:
    """The paper's RMSE of every setting, and below it the share found and the median RMSE of every group and way."""
    rows = []
    for setting, label in labelled_settings():
        printed = [ERRORS.get((setting.experiment, setting.name, method)) for method in METHODS]
        lines = []
        for group, way, keys in _rows(setting, groups, ways):
            ours = [cells.get(key) for key in keys]
            if any(ours):
                places = max(cell.places for cell in ours if cell is not None)
                lines.append(["", f"{places} x {group.name}", way.name, *map(_cell, ours)])
        if lines:
            paper = ["-" if one is None else as_printed(one.rmse_meters, 3) for one in printed]
            rows += [[label, "the paper", "", *paper], *lines]
    head = ["setting", "places", "normals, RANSAC", *SHORT.values()]
    return Table("Overview: share of runs found, median RMSE in meters", head, rows)


def difference_table(groups: Sequence[PlaceGroup], ways: Sequence[Procedure], differences: Differences) -> Table:
    """What color changes on the same places, in every setting, group and way that has places."""
    rows = []
    for setting, label in labelled_settings():
        for group, way, keys in _rows(setting, groups, ways):
            changes = [differences.get(key) for key in keys if key.method in COMPARED]
            if any(changes):
                places = max(one.places for one in changes if one is not None)
                texts = [text for one in changes for text in _change(one)]
                rows.append([label, f"{places} x {group.name}", way.name, *texts])
                label = ""
    head = ["setting", "places", "normals, RANSAC"]
    head += [f"{SHORT[method]}: {what}" for method in COMPARED for what in ("found, %", "RMSE, mm")]
    return Table("What color changes against FPFH alone, place by place", head, rows)


def intervals_csv(cells: Cells, differences: Differences) -> str:
    """Every interval as a line: of what, over how many places, its value and bounds, and what a difference says."""
    head = [*Key._fields, "quantity", "count", "value", "low", "high", "verdict"]
    lines: list[list[object]] = []
    for key, cell in cells.items():
        lines.append([*key, "found", cell.places, *cell.found, ""])
        lines.append([*key, "rmse_meters", cell.places, *cell.rmse, ""])
    for key, change in differences.items():
        lines.append([*key, "found_difference", change.places, *change.found, change.found_verdict])
        lines.append([*key, "rmse_meters_difference", change.places, *change.rmse, change.rmse_verdict])
    return csv_table(head, lines)


def labelled_settings() -> Iterator[tuple[PaperSetting, str]]:
    """Every setting in the order of the paper's tables, and a label with its experiment."""
    for experiment in TABLES:
        for setting in settings_of(experiment):
            yield setting, f"{experiment}: pose {setting.name}" if experiment == 1 else f"{experiment}: {setting.name}"


def _rows(
    setting: PaperSetting, groups: Sequence[PlaceGroup], ways: Sequence[Procedure]
) -> Iterator[tuple[PlaceGroup, Procedure, list[Key]]]:
    for group in groups:
        for way in ways:
            keys = [Key(setting.experiment, setting.name, group.name, way.name, method) for method in METHODS]
            yield group, way, keys


def _cell(cell: PaperCell | None) -> str:
    if cell is None:
        return "-"
    low, high = (number(bound) for bound in cell.rmse[1:])
    bounds = "" if low == high else f" [{low}, {high}]"
    return f"{_percent(cell.found)} %; {number(cell.rmse.value)}{bounds}"


def _change(change: Difference | None) -> tuple[str, str]:
    """The change of the share found, in percent of all runs, and of the RMSE in millimeters, each with its verdict."""
    if change is None:
        return "-", "-"
    millimeters = Interval(*(1000 * bound for bound in change.rmse))
    return (
        f"{_percent(change.found, '+')} {change.found_verdict}",
        f"{_text(millimeters, '+.0f')} {change.rmse_verdict}",
    )


def _percent(interval: Interval, sign: str = "") -> str:
    return _text(Interval(*(100 * bound for bound in interval)), f"{sign}.0f")


def _text(interval: Interval, form: str) -> str:
    """The value and its bounds in brackets, which are left out where they are the value; zero without a sign."""
    texts = [f"{bound:{form}}" for bound in interval]
    value, low, high = ("0" if float(text) == 0 else text for text in texts)
    return value if low == high else f"{value} [{low}, {high}]"
