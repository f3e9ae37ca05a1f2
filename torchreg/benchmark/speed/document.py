"""The tables of seconds, growth and peak memory, and the chart of seconds over points."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean, median

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Picture
from torchreg.benchmark.core.tables import markdown_table
from torchreg.benchmark.core.timing import spread
from torchreg.benchmark.speed import batches, busy, large
from torchreg.benchmark.speed.grid import RANSAC, STAGES, WHOLE
from torchreg.benchmark.speed.scene import NEIGHBORS
from torchreg.benchmark.speed.side_by_side import in_bytes, of_part, table_of_part
from torchreg.benchmark.speed.subjects import CLASSIC, COMPILED, METHODS, OURS, TENSOR
from torchreg.errors import expect

_COLORS = dict(zip(METHODS, ("#0072b2", "#56b4e9", "#d55e00", "#e69f00"), strict=True))

CAPTION = (
    "Two stations of a simulated mall, so many points a cloud drawn at random; supports 2 spacings (normals, 30 "
    f"nearest; color) and 5 spacings (FPFH, {NEIGHBORS} nearest). Stages take neighborhoods that are at hand, but for "
    "the rows that say search; Open3D searches in every stage. Open3D computes FPFH alone wherever it says FPFH + "
    "PCFH, and in the whole pair. RANSAC and the whole pair draw all hypotheses (600,000 in the whole pair, few in a "
    "quick run), without an early end. Medians in turn after a warm-up, least and most in brackets."
)


def markdown(rows: Sequence[Row]) -> str:
    """All tables with their captions."""
    stages = of_part(rows, "stages")
    parts = [CAPTION, times_table(stages), growth_table(stages), memory_table(stages)] if stages else []
    further = {
        batches.CAPTION: table_of_part(rows, batches.BATCHES),
        large.CAPTION: table_of_part(rows, large.LARGE),
        busy.CAPTION: busy.table(rows),
    }
    parts += [text for caption, table in further.items() if table for text in (caption, table)]
    return "\n\n".join(part for part in parts if part)


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
    for subject, size, ascending in series(rows):
        sizes = [row[size] for row in ascending]
        exponents = []
        for method in METHODS:
            costs = [median(row["seconds"][method]) for row in ascending if method in row["seconds"]]
            exponents.append(f"{slope(sizes, costs):.2f}" if len(costs) == len(sizes) else "")
        each = [median(row["seconds"][OURS]) / row[size] for row in ascending]
        flat = f"{max(each) / min(each):.2f}"
        lines.append([subject, size, f"{sizes[0]:,}", f"{sizes[-1]:,}", *exponents, flat])
    return markdown_table(head, lines)


def memory_table(rows: Sequence[Row]) -> str:
    """Peak memory above what the process held before, or an empty text where it was not measured."""
    measured = [row for row in _in_order(rows) if row.get("bytes")]
    if not measured:
        return ""
    lines = [
        [row["subject"], size_of(row), *(in_bytes(row["bytes"].get(method)) for method in METHODS)] for row in measured
    ]
    return "Peak memory above clouds and imports:\n\n" + markdown_table(["stage", "size", *METHODS], lines)


def series(rows: Sequence[Row]) -> list[tuple[str, str, list[Row]]]:
    """Rows of one subject in which one size alone changes: subject, that size, rows ascending."""
    listed = []
    for subject in dict.fromkeys(row["subject"] for row in rows):
        of_subject = [row for row in rows if row["subject"] == subject]
        for size in ("points", "neighbors", "hypotheses"):
            others = [name for name in ("points", "neighbors", "hypotheses") if name != size]
            groups: dict[tuple[int, ...], list[Row]] = {}
            for row in of_subject:
                groups.setdefault(tuple(row[name] for name in others), []).append(row)
            most = max(groups.values(), key=len)
            if len({row[size] for row in most}) > 1:
                listed.append((subject, size, sorted(most, key=lambda row, size=size: row[size])))  # type: ignore[misc]
    return listed


def slope(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """The exponent p of the power law cost ~ size^p that fits best (least squares over logarithms).

    Args:
        sizes: above 0, at least two different ones.
        costs: above 0, one per size.

    Example:
        >>> round(slope([1, 10, 100], [2, 20, 200]), 6)
        1.0
    """
    expect(len(sizes) == len(costs), "costs", f"one per size ({len(sizes)})", len(costs))
    expect(len(set(sizes)) > 1, "sizes", "at least two different ones", sizes)
    x, y = [math.log(size) for size in sizes], [math.log(cost) for cost in costs]
    mx, my = fmean(x), fmean(y)
    return sum((a - mx) * (b - my) for a, b in zip(x, y, strict=True)) / sum((a - mx) ** 2 for a in x)


def draw(rows: Sequence[Row], folder: Path) -> Iterator[Picture]:
    """Draw and save seconds over points, one panel per stage, both axes logarithmic."""
    from matplotlib.figure import Figure

    rows = of_part(rows, "stages")
    names = [name for name in STAGES if any(row["subject"] == name for row in rows)]
    if not names:
        return
    figure = Figure(figsize=(3.1 * len(names), 3.4), layout="constrained")
    panels = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for panel, name in zip(panels, names, strict=True):
        of_stage = [row for row in rows if row["subject"] == name and row["neighbors"] == NEIGHBORS]
        for method in METHODS:
            line = [(row["points"], median(row["seconds"][method])) for row in of_stage if method in row["seconds"]]
            if line:
                panel.plot(*zip(*line, strict=True), "o-", ms=4, lw=1.5, color=_COLORS[method], label=method)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_title(name, fontsize=10)
        panel.set_xlabel("points")
        panel.grid(alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("seconds")
    handles = {
        label: handle for panel in panels for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=len(METHODS), frameon=False)
    figure.savefig(folder / "speed.png", dpi=110)
    yield Picture(None, "speed.png", "Seconds of every stage over the number of points.")


def size_of(row: Row) -> str:
    """The number of points, and other sizes where they are not the usual ones."""
    words = [f"{row['points']:,} points"]
    words += [f"{row['neighbors']} neighbors"] if row["neighbors"] != NEIGHBORS else []
    words += [f"{row['hypotheses']:,} hypotheses"] if row["subject"] == RANSAC else []
    return ", ".join(words)


def _in_order(rows: Sequence[Row]) -> list[Row]:
    order = list(dict.fromkeys(row["subject"] for row in rows if row["subject"] not in (RANSAC, WHOLE)))
    order += [RANSAC, WHOLE]
    return sorted(rows, key=lambda row: order.index(row["subject"]))
