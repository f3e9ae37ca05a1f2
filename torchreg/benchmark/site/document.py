"""The tables of a comparison on sites, and the text around them."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.tables import Table, csv_table
from torchreg.benchmark.site.judge import DEGREES, VOXELS
from torchreg.benchmark.site.method import SiteMethod

TITLE = "Many scans in one frame"

CAPTION = (
    f"Share: pairs of scans with the right relative pose, within {DEGREES:g} degrees and {VOXELS:g} voxels; of a scene "
    "of pairs those pairs count that its list has. Wrong: how many scans have to be taken out until no pair of scans "
    "in one frame has a wrong relative pose; unplaced: those that a method leaves out. Millimeters and degrees: "
    "errors of the scans placed rightly in the largest frame, after the rigid motion that fits them best, their median "
    "(over sites the median of these) and the largest. Tried: share of all pairs of scans that "
    "were registered. Seconds: from the scans to the poses, all of it. Failed: sites on "
    "which a method ended with an error.\n\n"
    "All methods get the same scans, buildings as they were scanned, real ones averaged over the voxels of their site."
)

CSV_FIELDS = [
    *("site", "family", "scans", "voxel_m", "method", "share", "wrong", "unplaced"),
    *("median_mm", "largest_mm", "median_deg", "largest_deg", "tried", "seconds", "error"),
]

_Column = tuple[str, Callable[[Sequence[Row]], str]]


def document(rows: Sequence[Row], methods: Sequence[SiteMethod], machine: str) -> str:
    """The whole page as Markdown."""
    return f"# {TITLE}\n\n{sections(rows, methods)}\n\n{machine}\n"


def sections(rows: Sequence[Row], methods: Sequence[SiteMethod]) -> str:
    """What is counted, all tables, and how each method was run; Markdown without a newline at its end."""
    statements = [f"- {method.title} (`{method.name}`): {method.statement}" for method in methods]
    parts = [CAPTION, *(table.section for table in tables(rows, methods)), single_sites(rows, methods).section]
    return "\n\n".join([*parts, "## How each was run", "\n".join(statements)])


def tables(rows: Sequence[Row], methods: Sequence[SiteMethod]) -> list[Table]:
    """One table for each family of sites, the sites of a family together."""
    return _families(rows, methods, (*_FIGURES, _FAILED))


def narrow_tables(rows: Sequence[Row], methods: Sequence[SiteMethod]) -> list[Table]:
    """The same for a terminal: what matters most."""
    return _families(rows, methods, tuple(column for column in _FIGURES if column[0] in _IN_SHORT))


def _families(rows: Sequence[Row], methods: Sequence[SiteMethod], columns: Sequence[_Column]) -> list[Table]:
    made = []
    for family in dict.fromkeys(row["family"] for row in rows):
        of_family = [row for row in rows if row["family"] == family]
        scans = {row["site"]: row["scans"] for row in of_family}
        cells = [(method, [row for row in of_family if row["method"] == method.name]) for method in methods]
        lines = [[method.title, *(text(cell) for _, text in columns)] for method, cell in cells if cell]
        heading = f"{family.capitalize()}: {len(scans)} with {sum(scans.values())} scans"
        made.append(Table(heading, ["method", *(head for head, _ in columns)], lines))
    return made


def single_sites(rows: Sequence[Row], methods: Sequence[SiteMethod]) -> Table:
    """A line for each site and method."""
    lines = []
    for name in dict.fromkeys(row["site"] for row in rows):
        for method in methods:
            cell = [row for row in rows if row["site"] == name and row["method"] == method.name]
            lines += [[name, method.title, *(text([row]) for _, text in _ALONE)] for row in cell]
    return Table("Every site", ["site", "method", *(head for head, _ in _ALONE)], lines)


def csv_text(rows: Sequence[Row]) -> str:
    """One line per site and method."""
    return csv_table(CSV_FIELDS, [["" if row[name] is None else row[name] for name in CSV_FIELDS] for row in rows])


def _total(name: str) -> Callable[[Sequence[Row]], str]:
    return lambda rows: f"{sum(row[name] for row in rows)}"


def _mean(name: str, digits: int) -> Callable[[Sequence[Row]], str]:
    return lambda rows: f"{statistics.fmean(row[name] for row in rows):.{digits}f}"


def _errors(middle: str, largest: str, digits: int) -> Callable[[Sequence[Row]], str]:
    """The median over the sites of the median over their scans, and the largest of all."""

    def text(rows: Sequence[Row]) -> str:
        known = [row for row in rows if row[middle] is not None]
        if not known:
            return "-"
        center = statistics.median(row[middle] for row in known)
        return f"{center:.{digits}f} / {max(row[largest] for row in known):.{digits}f}"

    return text


_FIGURES: tuple[_Column, ...] = (
    ("share", _mean("share", 3)),
    ("wrong", _total("wrong")),
    ("unplaced", _total("unplaced")),
    ("mm", _errors("median_mm", "largest_mm", 1)),
    ("degrees", _errors("median_deg", "largest_deg", 2)),
    ("tried", _mean("tried", 2)),
    ("seconds", _mean("seconds", 1)),
)
_FAILED: _Column = ("failed", lambda rows: str(sum(bool(row["error"]) for row in rows)))
_IN_SHORT = ("share", "wrong", "unplaced", "mm", "seconds")
_ALONE: tuple[_Column, ...] = (
    ("scans", _total("scans")),
    *_FIGURES,
    ("frames", lambda rows: " + ".join(str(size) for row in rows for size in row["groups"]) or "-"),
    ("error", lambda rows: "; ".join(row["error"] for row in rows if row["error"]) or "-"),
)
