"""The paper's Table 8: its times, and ours for three spans of work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

from torchreg.benchmark.paper.layout import Table, as_printed
from torchreg.benchmark.paper.printed import SECONDS
from torchreg.benchmark.paper.settings import settings_of
from torchreg.benchmark.paper.times import SPANS, TIMED
from torchreg.benchmark.rows import Row
from torchreg.benchmark.timing import spread


def time_table(rows: Sequence[Row]) -> Table:
    """Table 8 from the rows of Experiment 4: medians with their range, with their range."""
    names = [setting.name for setting in settings_of(3)]
    by_name: Mapping[str, Row] = {row["setting"]: row for row in rows}
    lines = [[f"{method}, paper", *(f"{as_printed(SECONDS[name, method], 4)} s" for name in names)] for method in TIMED]
    for span in SPANS:
        for method in TIMED:
            texts = [_seconds(by_name.get(name), f"{span}/{method}") for name in names]
            lines.append([f"{method}, {span}", *texts])
        lines.append([f"added by PCFH, {span}", *(_added(by_name.get(name), span) for name in names)])
    return Table("Table 8", "processing times", ["Point count", *names], lines)


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


def _seconds(row: Row | None, name: str) -> str:
    if row is None:
        return "-"
    return spread(row["seconds"][name])


def _added(row: Row | None, span: str) -> str:
    return "-" if row is None else f"{added(row, span):+.0%}"
