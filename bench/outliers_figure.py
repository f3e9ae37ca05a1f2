"""The picture of ``outliers``: success and time over the outlier ratio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

COLORS = {
    "torchreg compatibility": "#0b6e4f",
    "torchreg RANSAC": "#3d9be9",
    "Open3D RANSAC": "#8a8a8a",
    "KISS-Matcher": "#d1603d",
}
MARKS = {"torchreg compatibility": "o", "torchreg RANSAC": "s", "Open3D RANSAC": "^", "KISS-Matcher": "D"}


def draw(cells: list[dict[str, Any]], path: Path) -> None:
    """Two columns, one per number of matches; success above, seconds below. The share of inliers is on a log axis."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    counts = sorted({cell["matches"] for cell in cells})
    ratios = sorted({cell["outlier_ratio"] for cell in cells})
    figure, axes = plt.subplots(2, len(counts), figsize=(10, 6.2), sharex=True, sharey="row", layout="constrained")
    for column, count in enumerate(counts):
        above, below = axes[:, column]
        for name, color in reversed(COLORS.items()):  # the first drawn last, on top
            own = [cell for cell in cells if cell["matches"] == count and cell["solver"] == name]
            if not own:
                continue
            x = [1 - cell["outlier_ratio"] for cell in own]
            style = {"color": color, "marker": MARKS[name], "linewidth": 2, "markersize": 6, "clip_on": False}
            above.plot(x, [100 * cell["solved"] / cell["problems"] for cell in own], label=name, **style)
            below.plot(x, [cell["seconds_median"] for cell in own], **style)
        above.set_title(f"{count:,} matches", fontweight="bold")
        above.set_ylim(0, 103)
        below.set_yscale("log")
        below.yaxis.set_major_formatter("{x:g}")
        below.set_xlabel("wrong matches")
        for panel in (above, below):
            panel.grid(color="#dddddd", linewidth=0.8)
            panel.spines[["top", "right"]].set_visible(False)
        below.set_xscale("log")
        below.set_xlim(0.55, 0.0047)
        below.set_xticks([1 - ratio for ratio in ratios], [f"{100 * ratio:g} %" for ratio in ratios], fontsize=8)
        below.minorticks_off()
    axes[0, 0].set_ylabel("problems solved, %")
    axes[1, 0].set_ylabel("median seconds per problem")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside upper center", ncols=4, frameon=False)
    numbers = [cell["problems"] for cell in cells]
    figure.supxlabel(f"{min(numbers)} to {max(numbers)} problems a point, fewer where they take long", fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)
