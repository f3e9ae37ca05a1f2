"""The tables of a comparison on real pairs, their caption, and the same numbers as CSV."""

from __future__ import annotations

from torchreg.benchmark.core.bootstrap import Interval
from torchreg.benchmark.core.tables import Table, csv_table
from torchreg.benchmark.field import summary
from torchreg.benchmark.field.summary import FieldCell, difference, groups, summarize
from torchreg.benchmark.peers.comparison import MethodComparison

BASE = "default"
"""The method that others are set against, pair by pair."""

_MEASURES = ("recall", "recall_rmse", "match_recall", "inlier_ratio", "rre_deg", "rte_m", "seconds")
_COUNTS = ("wrong_called_right", "right_refused", "errors")


def tables(comparison: MethodComparison) -> list[Table]:
    """All pairs by every measure, every measure by scene and by overlap, and pair by pair against the default."""
    cells = _cells(comparison)
    made = [_overall(comparison, cells)]
    for measure, heading in (
        ("recall", "Registration recall by errors"),
        ("recall_rmse", "Registration recall by RMSE"),
        ("match_recall", "Feature-match recall"),
        ("inlier_ratio", "Inlier ratio"),
        ("rre_deg", "Median RRE of pairs found, degrees"),
        ("rte_m", "Median RTE of pairs found, meters"),
        ("seconds", "Median seconds"),
    ):
        made.append(_by_group(comparison, cells, measure, heading))
    if any(row["method"] == BASE for row in comparison.rows):
        made.append(_differences(comparison))
    return made


def csv_text(comparison: MethodComparison) -> str:
    """One line per group, method and measure, with its interval; counts have none."""
    head = ["group", "method", "measure", "pairs", "value", "low", "high"]
    lines: list[list[object]] = []
    for (group, name), cell in _cells(comparison).items():
        for measure in _MEASURES:
            interval = getattr(cell, measure)
            lines.append([group, name, measure, cell.pairs, *(interval or ("", "", ""))])
        lines += [[group, name, count, cell.pairs, getattr(cell, count), "", ""] for count in _COUNTS]
    return csv_table(head, lines)


_NEAR = f"{summary.MATCH_VOXELS:g} v under the truth"

CAPTION = (
    "Every method gets the same clouds, means over voxels of each pair's edge v, and the same lengths: normals 2 v / "
    "30 neighbors, FPFH 5 v / 100 neighbors, inlier threshold 1.5 v.\n\n"
    f"Found by errors: RRE below {summary.ROTATION:g} degrees and RTE below {summary.TRANSLATION_VOXELS:g} v. Found "
    f"by RMSE: below {summary.RMSE_VOXELS:g} v over the source points that have a partner within {_NEAR}. Both "
    "whatever the method says of its success; where it is wrong on that, the last columns count it. Inlier ratio: "
    f"share of the matches within {_NEAR}. Feature-match recall: share of pairs where it is above "
    f"{summary.LEAST_INLIER_RATIO:g}. At v = 5 cm these are 3DMatch's 0.3 m, 0.2 m and 0.1 m.\n\n"
    "In brackets: 95 % percentile intervals of 10,000 bootstrap samples of pairs, none where all pairs "
    "agree. Seconds: from the clouds to the pose."
)


def _cells(comparison: MethodComparison) -> dict[tuple[str, str], FieldCell]:
    cells = {}
    for group, belongs in groups(comparison.rows):
        for method in comparison.methods:
            rows = [row for row in comparison.of(method) if belongs(row)]
            if rows:
                cells[group, method.name] = summarize(rows, comparison.seed)
    return cells


def _overall(comparison: MethodComparison, cells: dict[tuple[str, str], FieldCell]) -> Table:
    head = ["method", "pairs", "recall (errors)", "recall (RMSE)", "feature-match recall", "inlier ratio"]
    head += ["RRE (deg)", "RTE (m)", "seconds", "wrong, called right", "right, refused", "ended with an error"]
    rows = []
    for method in comparison.methods:
        cell = cells.get(("all pairs", method.name))
        if cell is None:
            rows.append(comparison.empty(method, len(head) - 1))
            continue
        texts = [_text(getattr(cell, measure), measure) for measure in _MEASURES]
        counts = [str(getattr(cell, count)) for count in _COUNTS]
        rows.append([method.title, str(cell.pairs), *texts, *counts])
    return Table("All pairs", head, rows)


def _by_group(
    comparison: MethodComparison, cells: dict[tuple[str, str], FieldCell], measure: str, heading: str
) -> Table:
    parts = [group for group, _ in groups(comparison.rows)]
    sizes = {
        group: max((cells[group, m.name].pairs for m in comparison.methods if (group, m.name) in cells), default=0)
        for group in parts
    }
    rows = []
    for method in comparison.methods:
        by_group = [cells.get((group, method.name)) for group in parts]
        if not any(by_group):
            rows.append(comparison.empty(method, len(parts)))
            continue
        texts = ["-" if cell is None else _text(getattr(cell, measure), measure) for cell in by_group]
        rows.append([method.title, *texts])
    return Table(heading, ["method", *(f"{group} ({sizes[group]})" for group in parts)], rows)


def _differences(comparison: MethodComparison) -> Table:
    base = [row for row in comparison.rows if row["method"] == BASE]
    title = next((method.title for method in comparison.methods if method.name == BASE), BASE)
    rows = []
    for method in comparison.methods:
        of_method = comparison.of(method)
        if method.name != BASE and of_method:
            rows.append([method.title, _text(difference(of_method, base, comparison.seed), "difference")])
    return Table(f"Recall by errors less that of {title}, pair by pair", ["method", "difference"], rows)


def _text(interval: Interval | None, measure: str) -> str:
    if interval is None:
        return "-"
    digits = {"inlier_ratio": 3, "rte_m": 3, "rre_deg": 2}.get(measure, 2)
    sign = "+" if measure == "difference" else ""
    value, low, high = (f"{number:{sign}.{digits}f}" for number in interval)
    return value if low == high else f"{value} [{low}, {high}]"
