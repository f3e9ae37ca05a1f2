"""The paper's Tables 5 to 9 in its own layout: its printed numbers, and ours below each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from torchreg.benchmark.paper.methods import METHODS, SHORT, TITLES
from torchreg.benchmark.paper.places import Group
from torchreg.benchmark.paper.printed import ERRORS
from torchreg.benchmark.paper.settings import TABLES, settings_of
from torchreg.benchmark.paper.summary import Cell, Key

LABELS = {"rre_degrees": "RRE/°", "rte_meters": "RTE/m", "rmse_meters": "RMSE/m"}

_COLUMN_NAMES = {1: "Initial pose", 3: "Point count"}
_STACKED = 3  # the experiment whose methods the paper puts one below the other

Cells = Mapping[Key, Cell]


class Table(NamedTuple):
    """A table to print: its number with a letter for the group, a heading, the head, and rows of texts."""

    name: str
    heading: str
    head: list[str]
    rows: list[list[str]]


def error_table(experiment: int, group: Group, cells: Cells, part: str = "") -> Table:
    """The paper's table of one experiment, its numbers beside ours on one group of places.

    Args:
        experiment: 1, 2, 3 or 5.
        group: which places.
        cells: of ``summarize``; what is not there is left open.
        part: a letter behind the number of the table.
    """
    settings = [setting.name for setting in settings_of(experiment)]
    blocks = [_block(experiment, method, settings, group, cells) for method in METHODS]
    name = f"Table {TABLES[experiment]}{part}"
    column = _COLUMN_NAMES.get(experiment)
    if experiment == _STACKED:
        rows = []
        for method, block in zip(METHODS, blocks, strict=True):
            rows.append([f"**{TITLES[method]}**", *[""] * len(settings)])
            rows += block
        return Table(name, group.title, [column or "", *settings], rows)
    gaps = [""] * (len(settings) - 1)
    head = ["", *(text for method in METHODS for text in (TITLES[method], *gaps))]
    rows = [[column, *settings * len(METHODS)]] if column else []
    for lines in zip(*blocks, strict=True):
        rows.append([lines[0][0], *(text for line in lines for text in line[1:])])
    return Table(name, group.title, head, rows)


def overview_table(groups: Sequence[Group], cells: Cells) -> Table:
    """The paper's RMSE of every setting, and below it, for each group, pairs found and median RMSE in meters."""
    rows = []
    for experiment in TABLES:
        for setting in settings_of(experiment):
            names = (experiment, setting.name)
            own = {group.name: [cells.get((*names, group.name, method)) for method in METHODS] for group in groups}
            lines = [[name, *map(_short, found)] for name, found in own.items() if any(found)]
            if lines:
                printed = [ERRORS.get((*names, method)) for method in METHODS]
                paper = ["-" if one is None else as_printed(one.rmse_meters, 3) for one in printed]
                heading = f"{experiment}: pose {setting.name}" if experiment == 1 else f"{experiment}: {setting.name}"
                rows += [[heading, "the paper", *paper], *(["", *line] for line in lines)]
    return Table("Overview", "pairs found, median RMSE in meters", ["setting", "places", *SHORT.values()], rows)


def _block(experiment: int, method: str, settings: Sequence[str], group: Group, cells: Cells) -> list[list[str]]:
    """The lines of one method: a label, then one text per setting."""
    printed = [ERRORS.get((experiment, name, method)) for name in settings]
    own = [cells.get((experiment, name, group.name, method)) for name in settings]
    lines = []
    for measure, label in LABELS.items():
        lines.append(
            [f"{label}, paper", *("-" if one is None else as_printed(getattr(one, measure), 3) for one in printed)]
        )
        lines.append([f"{label}, ours", *(_spread(cell, measure) for cell in own)])
    lines.append(["RMSE/m, our median", *(_median(cell, "rmse_meters") for cell in own)])
    lines.append(["found", *("-" if cell is None else f"{cell.found} / {cell.runs}" for cell in own)])
    lines.append(["inlier ratio", *(_median(cell, "inlier_ratio") for cell in own)])
    return lines


def _spread(cell: Cell | None, measure: str) -> str:
    if cell is None:
        return "-"
    one = cell.spreads[measure]
    return number(one.mean) if one.deviation is None else f"{number(one.mean)} ± {number(one.deviation)}"


def _median(cell: Cell | None, measure: str) -> str:
    return "-" if cell is None else number(cell.spreads[measure].median)


def _short(cell: Cell | None) -> str:
    return "-" if cell is None else f"{cell.found}/{cell.runs}, {_median(cell, 'rmse_meters')}"


def as_printed(value: float, decimals: int) -> str:
    """A number of the paper with the zeros that it prints; those with more digits keep them."""
    return f"{value:.{decimals}f}" if round(value, decimals) == value else f"{value:g}"


def number(value: float) -> str:
    """Three decimals below 10, as the paper has them, one above."""
    return f"{value:.3f}" if abs(value) < 10 else f"{value:.1f}"
