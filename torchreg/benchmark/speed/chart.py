"""Seconds over points, one panel a stage, both axes logarithmic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median

from torchreg.benchmark.rows import Row
from torchreg.benchmark.speed.grid import STAGES
from torchreg.benchmark.speed.scene import NEIGHBORS
from torchreg.benchmark.speed.subjects import METHODS

_COLORS = dict(zip(METHODS, ("#0072b2", "#56b4e9", "#d55e00", "#e69f00"), strict=True))


def draw(rows: Sequence[Row], path: Path) -> Path:
    """Draw the stages and save."""
    from matplotlib.figure import Figure

    names = [name for name in STAGES if any(row["subject"] == name for row in rows)]
    figure = Figure(figsize=(3.1 * len(names), 3.4), layout="constrained")
    panels = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for panel, name in zip(panels, names, strict=True):
        own = [row for row in rows if row["subject"] == name and row["neighbors"] == NEIGHBORS]
        for method in METHODS:
            line = [(row["points"], median(row["seconds"][method])) for row in own if method in row["seconds"]]
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
    figure.savefig(path, dpi=110)
    return path
