"""The tables as Markdown and as CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from torchreg.benchmark.bootstrap import Interval
from torchreg.benchmark.field import criteria
from torchreg.benchmark.field.summary import Cell, Row, difference, groups, summarize
from torchreg.benchmark.peers import Method
from torchreg.benchmark.peers.words import how_and_gaps, nothing
from torchreg.benchmark.tables import Table, csv_table, markdown_table

BASE = "default"
"""The method that others are set against, pair by pair."""

_MEASURES = ("recall", "recall_rmse", "match_recall", "inlier_ratio", "rre_deg", "rte_m", "seconds")
_COUNTS = ("wrong_called_right", "right_refused", "errors")


class Findings(NamedTuple):
    """What was measured, and by which methods.

    Attributes:
        rows: one a pair and method.
        methods: those asked for, in order.
        gaps: why some of them could not run, by name.
        seed: of the intervals.
    """

    rows: Sequence[Row]
    methods: Sequence[Method]
    gaps: Mapping[str, str]
    seed: int = 0


def tables(findings: Findings) -> list[Table]:
    """All pairs by every measure, every measure by scene and by overlap, and pair by pair against the default."""
    parts = groups(findings.rows)
    cells = _cells(findings)
    whole, _ = parts[0]
    found = [_overall(findings, cells, whole)]
    for measure, heading in (
        ("recall", "Registration recall by errors"),
        ("recall_rmse", "Registration recall by RMSE"),
        ("match_recall", "Feature-match recall"),
        ("inlier_ratio", "Inlier ratio"),
        ("rre_deg", "Median RRE of pairs found, degrees"),
        ("rte_m", "Median RTE of pairs found, meters"),
        ("seconds", "Median seconds"),
    ):
        found.append(_by_group(findings, cells, measure, heading))
    if any(row["method"] == BASE for row in findings.rows):
        found.append(_differences(findings))
    return found


def markdown(findings: Findings, machine: str) -> str:
    """The whole document; ``machine`` is its last line."""
    parts = ["# The field on real pairs", CAPTION]
    for table in tables(findings):
        parts += [f"## {table.heading}", markdown_table(table.head, table.rows)]
    parts += how_and_gaps(findings.methods, findings.gaps)
    return "\n\n".join([*parts, machine]) + "\n"


def csv_text(findings: Findings) -> str:
    """One line a group, method and measure, with its interval; counts have none."""
    head = ["group", "method", "measure", "pairs", "value", "low", "high"]
    lines: list[list[object]] = []
    for (group, name), cell in _cells(findings).items():
        for measure in _MEASURES:
            interval = getattr(cell, measure)
            lines.append([group, name, measure, cell.pairs, *(interval or ("", "", ""))])
        lines += [[group, name, count, cell.pairs, getattr(cell, count), "", ""] for count in _COUNTS]
    return csv_table(head, lines)


_NEAR = f"{criteria.MATCH_VOXELS:g} v under the truth"

CAPTION = (
    "Every method gets the same clouds, means over voxels of each pair's edge v, and the same lengths: normals 2 v / "
    "30 neighbors, FPFH 5 v / 100 neighbors, inlier threshold 1.5 v.\n\n"
    f"Found by errors: RRE below {criteria.ROTATION:g} degrees and RTE below {criteria.TRANSLATION_VOXELS:g} v. Found "
    f"by RMSE: below {criteria.RMSE_VOXELS:g} v over the source points that have a partner within {_NEAR}. Both "
    "whatever the method says of its success; where it is wrong on that, the last columns count it. Inlier ratio: "
    f"share of the matches within {_NEAR}. Feature-match recall: share of pairs where it is above "
    f"{criteria.MATCHED:g}. At v = 5 cm these are 3DMatch's 0.3 m, 0.2 m and 0.1 m.\n\n"
    "In brackets: 95 % percentile intervals of 10,000 bootstrap samples of pairs, none where all pairs "
    "agree. Seconds: from the clouds to the pose."
)


def _cells(findings: Findings) -> dict[tuple[str, str], Cell]:
    cells = {}
    for group, belongs in groups(findings.rows):
        for method in findings.methods:
            own = [row for row in findings.rows if row["method"] == method.name and belongs(row)]
            if own:
                cells[group, method.name] = summarize(own, findings.seed)
    return cells


def _overall(findings: Findings, cells: dict[tuple[str, str], Cell], group: str) -> Table:
    head = ["method", "pairs", "recall (errors)", "recall (RMSE)", "feature-match recall", "inlier ratio"]
    head += ["RRE (deg)", "RTE (m)", "seconds", "wrong, called right", "right, refused", "ended with an error"]
    rows = []
    for method in findings.methods:
        cell = cells.get((group, method.name))
        if cell is None:
            rows.append([method.title, *nothing(method, findings.gaps, len(head) - 1)])
            continue
        texts = [_text(getattr(cell, measure), measure) for measure in _MEASURES]
        counts = [str(getattr(cell, count)) for count in _COUNTS]
        rows.append([method.title, str(cell.pairs), *texts, *counts])
    return Table("All pairs", head, rows)


def _by_group(findings: Findings, cells: dict[tuple[str, str], Cell], measure: str, heading: str) -> Table:
    parts = [group for group, _ in groups(findings.rows)]
    sizes = {
        group: max((cells[group, m.name].pairs for m in findings.methods if (group, m.name) in cells), default=0)
        for group in parts
    }
    rows = []
    for method in findings.methods:
        own = [cells.get((group, method.name)) for group in parts]
        if all(cell is None for cell in own):
            rows.append([method.title, *nothing(method, findings.gaps, len(parts))])
            continue
        rows.append([method.title, *("-" if cell is None else _text(getattr(cell, measure), measure) for cell in own)])
    return Table(heading, ["method", *(f"{group} ({sizes[group]})" for group in parts)], rows)


def _differences(findings: Findings) -> Table:
    base = [row for row in findings.rows if row["method"] == BASE]
    title = next((method.title for method in findings.methods if method.name == BASE), BASE)
    rows = []
    for method in findings.methods:
        own = [row for row in findings.rows if row["method"] == method.name]
        if method.name == BASE or not own:
            continue
        apart = difference(own, base, findings.seed)
        rows.append([method.title, _text(apart, "difference")])
    return Table(f"Recall by errors less that of {title}, pair by pair", ["method", "difference"], rows)


def _text(interval: Interval | None, measure: str) -> str:
    if interval is None:
        return "-"
    digits = {"inlier_ratio": 3, "rte_m": 3, "rre_deg": 2}.get(measure, 2)
    sign = "+" if measure == "difference" else ""
    value, low, high = (f"{number:{sign}.{digits}f}" for number in interval)
    return value if low == high else f"{value} [{low}, {high}]"
