"""The paper's Tables 5 to 9 in its own layout: its printed numbers, and ours below each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.tables import Table
from torchreg.benchmark.core.timing import spread
from torchreg.benchmark.paper.methods import METHODS, TITLES
from torchreg.benchmark.paper.places import PlaceGroup
from torchreg.benchmark.paper.printed import ERRORS, SECONDS
from torchreg.benchmark.paper.settings import TABLES, settings_of
from torchreg.benchmark.paper.summary import Cells, Key, PaperCell
from torchreg.benchmark.paper.times import SPANS, TIMED
from torchreg.benchmark.paper.ways import Procedure

LABELS = {"rre_degrees": "RRE/°", "rte_meters": "RTE/m", "rmse_meters": "RMSE/m"}

_COLUMN_NAMES = {1: "Initial pose", 3: "Point count"}
_STACKED = 3  # the experiment whose methods the paper puts one below the other


def error_table(experiment: int, group: PlaceGroup, way: Procedure, cells: Cells, part: str = "") -> Table:
    """The paper's table of experiment 1, 2, 3 or 5, its numbers beside ours on one group of places in one way.

    Cells that are missing are left open; ``part`` is a letter behind the number of the table.
    """
    settings = [setting.name for setting in settings_of(experiment)]
    blocks = [_block(experiment, method, settings, group, way, cells) for method in METHODS]
    heading = f"Table {TABLES[experiment]}{part}: {group.title}; {way.title}"
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


def _block(
    experiment: int, method: str, settings: Sequence[str], group: PlaceGroup, way: Procedure, cells: Cells
) -> list[list[str]]:
    """The lines of one method: a label, then one text per setting."""
    printed = [ERRORS.get((experiment, name, method)) for name in settings]
    ours = [cells.get(Key(experiment, name, group.name, way.name, method)) for name in settings]
    lines = []
    for measure, label in LABELS.items():
        lines.append(
            [f"{label}, paper", *("-" if one is None else as_printed(getattr(one, measure), 3) for one in printed)]
        )
        lines.append([f"{label}, ours", *(_spread(cell, measure) for cell in ours)])
    lines.append(["RMSE/m, our median", *(_median(cell, "rmse_meters") for cell in ours)])
    lines.append(["found", *("-" if cell is None else f"{cell.found.value:.0%} of {cell.places}" for cell in ours)])
    lines.append(["inlier ratio", *(_median(cell, "inlier_ratio") for cell in ours)])
    return lines


def _spread(cell: PaperCell | None, measure: str) -> str:
    if cell is None:
        return "-"
    one = cell.spreads[measure]
    return number(one.mean) if one.deviation is None else f"{number(one.mean)} ± {number(one.deviation)}"


def _median(cell: PaperCell | None, measure: str) -> str:
    return "-" if cell is None else number(cell.spreads[measure].median)


def _seconds(row: Row | None, name: str) -> str:
    return "-" if row is None else spread(row["seconds"][name])


def _added(row: Row | None, span: str) -> str:
    return "-" if row is None else f"{added(row, span):+.0%}"
