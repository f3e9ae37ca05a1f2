"""The tables: seconds and how many times faster, growth as slopes, peak memory."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from torchreg.benchmark.rows import Row
from torchreg.benchmark.speed.grid import RANSAC, WHOLE
from torchreg.benchmark.speed.growth import slope
from torchreg.benchmark.speed.scene import NEIGHBORS
from torchreg.benchmark.speed.subjects import CLASSIC, COMPILED, METHODS, OURS, TENSOR
from torchreg.benchmark.tables import markdown_table
from torchreg.benchmark.timing import spread

CAPTION = (
    "Two stations of a simulated mall, so many points a cloud drawn at random; supports 2 spacings (normals, 30 "
    f"nearest; color) and 5 spacings (FPFH, {NEIGHBORS} nearest). Stages take neighborhoods that are at hand, but for "
    "the rows that say search; Open3D searches in every stage. Open3D computes FPFH alone wherever it says FPFH + "
    "PCFH, and in the whole pair. RANSAC and the whole pair draw all hypotheses (600,000 in the whole pair), without "
    "an early end. Medians in turn after a warm-up, least and most in brackets."
)


def markdown(rows: Sequence[Row]) -> str:
    """All tables with their captions."""
    parts = [CAPTION, times_table(rows), growth_table(rows)]
    weighed = memory_table(rows)
    return "\n\n".join(part for part in [*parts, weighed] if part)


def times_table(rows: Sequence[Row]) -> str:
    """Seconds of every cell by method, and the ratios to Open3D's."""
    head = ["stage", "size", *METHODS, "faster than Open3D", "than its tensor"]
    lines = []
    for row in _in_order(rows):
        seconds = row["seconds"]
        best = [name for name in (OURS, COMPILED) if name in seconds]
        ratios = [
            " / ".join(f"{median(seconds[other]) / median(seconds[name]):.1f}" for name in best)
            if other in seconds
            else ""
            for other in (CLASSIC, TENSOR)
        ]
        times = [spread(seconds[name]) if name in seconds else "" for name in METHODS]
        lines.append([row["subject"], size_of(row), *times, *ratios])
    return markdown_table(head, lines)


def growth_table(rows: Sequence[Row]) -> str:
    """The exponent of the power law of cost over points, neighbors and hypotheses, and cost per point."""
    head = ["stage", "cost grows with", "from", "to", *METHODS, "torchreg's cost per unit, most / least"]
    lines = []
    for subject, size, own in series(rows):
        sizes = [row[size] for row in own]
        exponents = []
        for method in METHODS:
            costs = [median(row["seconds"][method]) for row in own if method in row["seconds"]]
            exponents.append(f"{slope(sizes, costs):.2f}" if len(costs) == len(sizes) else "")
        each = [median(row["seconds"][OURS]) / row[size] for row in own]
        flat = f"{max(each) / min(each):.2f}"
        lines.append([subject, size, f"{sizes[0]:,}", f"{sizes[-1]:,}", *exponents, flat])
    return markdown_table(head, lines)


def memory_table(rows: Sequence[Row]) -> str:
    """Peak memory above what was held before, where it was measured; else nothing."""
    weighed = [row for row in _in_order(rows) if row.get("bytes")]
    if not weighed:
        return ""
    lines = [
        [row["subject"], size_of(row), *(_bytes(row["bytes"].get(method)) for method in METHODS)] for row in weighed
    ]
    return "Peak memory above clouds and imports:\n\n" + markdown_table(["stage", "size", *METHODS], lines)


def series(rows: Sequence[Row]) -> list[tuple[str, str, list[Row]]]:
    """Rows of one subject in which one size alone changes: subject, that size, rows ascending."""
    found = []
    for subject in dict.fromkeys(row["subject"] for row in rows):
        own = [row for row in rows if row["subject"] == subject]
        for size in ("points", "neighbors", "hypotheses"):
            others = [name for name in ("points", "neighbors", "hypotheses") if name != size]
            groups: dict[tuple[int, ...], list[Row]] = {}
            for row in own:
                groups.setdefault(tuple(row[name] for name in others), []).append(row)
            most = max(groups.values(), key=len)
            if len({row[size] for row in most}) > 1:
                found.append((subject, size, sorted(most, key=lambda row, size=size: row[size])))  # type: ignore[misc]
    return found


def size_of(row: Row) -> str:
    """Points, and what else is not as usual."""
    words = [f"{row['points']:,} points"]
    words += [f"{row['neighbors']} neighbors"] if row["neighbors"] != NEIGHBORS else []
    words += [f"{row['hypotheses']:,} hypotheses"] if row["subject"] == RANSAC else []
    return ", ".join(words)


def _in_order(rows: Sequence[Row]) -> list[Row]:
    order = list(dict.fromkeys(row["subject"] for row in rows if row["subject"] not in (RANSAC, WHOLE)))
    order += [RANSAC, WHOLE]
    return sorted(rows, key=lambda row: order.index(row["subject"]))


def _bytes(count: int | None) -> str:
    if count is None:
        return ""
    return f"{count / 2**30:.2f} GiB" if count >= 2**30 else f"{count / 2**20:.0f} MiB"
