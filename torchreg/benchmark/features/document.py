"""The tables of features on pairs of known truth: all pairs, each measure by scene and by overlap, and the CSV."""

from __future__ import annotations

from torchreg.benchmark.core.bootstrap import Interval
from torchreg.benchmark.core.tables import Table, csv_table
from torchreg.benchmark.features.protocol import FeatureScore, Protocol, score
from torchreg.benchmark.field.summary import LEAST_INLIER_RATIO, groups
from torchreg.benchmark.peers.comparison import MethodComparison

_MEASURES = (
    ("recall", "Registration recall"),
    ("match_recall", "Feature-match recall"),
    ("inlier_ratio", "Inlier ratio"),
)
_COUNTS = ("successes", "wrong_called_right", "right_refused", "errors")


def tables(comparison: MethodComparison, protocol: Protocol) -> list[Table]:
    """All pairs by every measure, then every measure by group."""
    scores = _scores(comparison, protocol)
    head = ["method", "pairs", *(heading.lower() for _, heading in _MEASURES), "matches", "seconds"]
    head += ["called a success", "of those wrong", "right, refused", "ended with an error"]
    rows = []
    for method in comparison.methods:
        cell = scores.get(("all pairs", method.name))
        if cell is None:
            rows.append(comparison.empty(method, len(head) - 1))
            continue
        shares = [_text(getattr(cell, measure)) for measure, _ in _MEASURES]
        matches = "-" if cell.matches is None else f"{cell.matches:.0f}"
        counts = [str(getattr(cell, count)) for count in _COUNTS]
        rows.append([method.title, str(cell.pairs), *shares, matches, f"{cell.seconds:.2f}", *counts])
    made = [Table("All pairs", head, rows)]
    return made + [_by_group(comparison, scores, measure, heading) for measure, heading in _MEASURES]


def csv_text(comparison: MethodComparison, protocol: Protocol) -> str:
    """One line per group, method and measure, with its interval; counts have none."""
    lines: list[list[object]] = []
    for (group, name), cell in _scores(comparison, protocol).items():
        for measure, _ in _MEASURES:
            lines.append([group, name, measure, cell.pairs, *(getattr(cell, measure) or ("", "", ""))])
        for number in ("matches", "seconds", *_COUNTS):
            value = getattr(cell, number)
            lines.append([group, name, number, cell.pairs, "" if value is None else value, "", ""])
    return csv_table(["group", "method", "measure", "pairs", "value", "low", "high"], lines)


def caption(protocol: Protocol) -> str:
    """The caption above the tables."""
    error, near = protocol.words
    return (
        "Every method gets the same clouds, means over voxels of each pair's edge v, and features become poses in the "
        "same way: normals 2 v, inlier threshold 1.5 v.\n\n"
        f"Registration recall: share of the pairs whose root mean square error is below {error}, over the source "
        f"points that have a partner within {near} under the truth, whatever a method says of its success; the last "
        f"columns count that. Inlier ratio: share of the matches within {near} under the truth. Feature-match recall: "
        f"share of the pairs where it is above {LEAST_INLIER_RATIO:g}. At v = 5 cm the bounds by voxels are those of "
        "3DMatch and Color3DMatch, 0.2 m and 0.1 m.\n\n"
        "In brackets: 95 % percentile intervals of 10,000 bootstrap samples of pairs, none where all pairs agree. "
        "Matches and seconds, from the clouds to the pose, are medians."
    )


def _scores(comparison: MethodComparison, protocol: Protocol) -> dict[tuple[str, str], FeatureScore]:
    scores = {}
    for group, belongs in groups(comparison.rows):
        for method in comparison.methods:
            rows = [row for row in comparison.of(method) if belongs(row)]
            if rows:
                scores[group, method.name] = score(rows, protocol, comparison.seed)
    return scores


def _by_group(
    comparison: MethodComparison, scores: dict[tuple[str, str], FeatureScore], measure: str, heading: str
) -> Table:
    parts = [group for group, _ in groups(comparison.rows)]
    sizes = [max(cell.pairs for (name, _), cell in scores.items() if name == group) for group in parts]
    rows = []
    for method in comparison.methods:
        cells = [scores.get((group, method.name)) for group in parts]
        if not any(cells):
            rows.append(comparison.empty(method, len(parts)))
            continue
        rows.append([method.title, *("-" if cell is None else _text(getattr(cell, measure)) for cell in cells)])
    return Table(heading, ["method", *(f"{group} ({size})" for group, size in zip(parts, sizes, strict=True))], rows)


def _text(interval: Interval | None) -> str:
    if interval is None:
        return "-"
    value, low, high = (f"{number:.3f}" for number in interval)
    return value if low == high else f"{value} [{low}, {high}]"
