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
    "in one frame has a wrong relative pose; unplaced: those that a method leaves out. Errors: of the scans placed "
    "rightly in the largest frame, after the rigid motion that fits them best. Tried: share of all pairs of scans that "
    "were registered. Seconds: from the scans to the poses, all of it.\n\n"
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
    parts = [CAPTION, *(table.section for table in tables(rows, methods))]
    return "\n\n".join([*parts, "## How each was run", "\n".join(statements)])


def tables(rows: Sequence[Row], methods: Sequence[SiteMethod]) -> list[Table]:
    """Families of sites, then every site."""
    return [_by(rows, methods, "family", "Sites of a kind together", _FAMILY), *_by_site(rows, methods)]


def csv_text(rows: Sequence[Row]) -> str:
    """One line per site and method."""
    return csv_table(CSV_FIELDS, [["" if row[name] is None else row[name] for name in CSV_FIELDS] for row in rows])


def _by_site(rows: Sequence[Row], methods: Sequence[SiteMethod]) -> list[Table]:
    families = dict.fromkeys(row["family"] for row in rows)
    return [
        _by([row for row in rows if row["family"] == family], methods, "site", family.capitalize(), _ONE)
        for family in families
    ]


def _by(
    rows: Sequence[Row], methods: Sequence[SiteMethod], key: str, heading: str, columns: Sequence[_Column]
) -> Table:
    lines = []
    for name in dict.fromkeys(row[key] for row in rows):
        for method in methods:
            cell = [row for row in rows if row[key] == name and row["method"] == method.name]
            if cell:
                lines.append([str(name), method.title, *(text(cell) for _, text in columns)])
    return Table(heading, [key, "method", *(head for head, _ in columns)], lines)


def _total(name: str) -> Callable[[Sequence[Row]], str]:
    return lambda rows: f"{sum(row[name] for row in rows)}"


def _mean(name: str, digits: int) -> Callable[[Sequence[Row]], str]:
    return lambda rows: f"{statistics.fmean(row[name] for row in rows):.{digits}f}"


def _known(name: str, digits: int, of: Callable[[list[float]], float]) -> Callable[[Sequence[Row]], str]:
    def text(rows: Sequence[Row]) -> str:
        values = [row[name] for row in rows if row[name] is not None]
        return f"{of(values):.{digits}f}" if values else "-"

    return text


def _errors(rows: Sequence[Row]) -> str:
    return "; ".join(row["error"] for row in rows if row["error"]) or "-"


_FIGURES: tuple[_Column, ...] = (
    ("share", _mean("share", 3)),
    ("wrong", _total("wrong")),
    ("unplaced", _total("unplaced")),
    ("median, mm", _known("median_mm", 1, statistics.median)),
    ("largest, mm", _known("largest_mm", 1, max)),
    ("median, deg", _known("median_deg", 3, statistics.median)),
    ("largest, deg", _known("largest_deg", 3, max)),
    ("tried", _mean("tried", 2)),
    ("seconds", _mean("seconds", 1)),
)
_FAMILY: tuple[_Column, ...] = (
    ("sites", lambda rows: str(len(rows))),
    ("scans", _total("scans")),
    *_FIGURES,
    ("ended with an error", lambda rows: str(sum(bool(row["error"]) for row in rows))),
)
_ONE: tuple[_Column, ...] = (
    ("scans", _total("scans")),
    *_FIGURES,
    ("frames", lambda rows: " + ".join(str(size) for row in rows for size in row["groups"]) or "-"),
    ("error", _errors),
)
