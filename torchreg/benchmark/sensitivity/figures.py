"""A chart of the sweep: one panel an axis, inlier ratio by value, scene by scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from torchreg.benchmark.sensitivity.measure import Worth
from torchreg.learning.prepared import PreparedPair

Found = dict[str, dict[str, list[Worth]]]


def draw_sweep(pairs: Sequence[PreparedPair], found: Found, chosen: dict[str, str], path: Path) -> Path:
    """Draw and save; ``chosen`` names the center's value on every axis, marked by a line."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(pair.scene for pair in pairs))
    colors = mpl.color_sequences["tab10"]
    figure = Figure(figsize=(13, 6.2), layout="constrained")
    for place, (axis, values) in enumerate(found.items()):
        panel = figure.add_subplot(2, 4, place + 1)
        names = [name.replace("hue", "h").replace("saturation", "s").replace("value", "v") for name in values]
        for number, scene in enumerate(scenes):
            own = [i for i, pair in enumerate(pairs) if pair.scene == scene]
            means = [fmean(worths[i].inlier_ratio for i in own) for worths in values.values()]
            panel.plot(
                range(len(names)), means, "o-", ms=4, lw=1.4, color=colors[number], label=scene.replace("_", " ")
            )
        panel.axvline(list(values).index(chosen[axis]), color="0.8", lw=6, zorder=0)
        panel.set_xticks(range(len(names)), names, rotation=30 if max(map(len, names)) > 4 else 0)
        panel.set_title(axis.replace("_", " "), fontsize=10)
        panel.set_ylim(bottom=0)
        panel.spines[["top", "right"]].set_visible(False)
        if place % 4 == 0:
            panel.set_ylabel("inlier ratio")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(scenes), frameon=False, fontsize=9)
    figure.savefig(path, dpi=120)
    return path
