"""A chart of what color changes: every difference against FPFH alone as a dot with its interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from torchreg.benchmark.paper.charts import COLORS
from torchreg.benchmark.paper.intervals import COMPARED, labelled_settings
from torchreg.benchmark.paper.places import PlaceGroup
from torchreg.benchmark.paper.summary import LEAST_PLACES, Differences, Key
from torchreg.benchmark.paper.ways import Procedure
from torchreg.report.canvas import add_legend, blank_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANEL = 4.6  # inches across
_LINE = 0.34  # inches high
_OFFSETS = (-0.16, 0.16)  # lines, of the methods
_LINEAR = 10.0  # millimeters: the axis of errors is linear up to here and logarithmic beyond


def differences_chart(groups: Sequence[PlaceGroup], ways: Sequence[Procedure], differences: Differences) -> Figure:
    """For every way two panels, of the share found and of the RMSE, with a line for every group and setting.

    Dots are hollow, and have no interval, where places are too few to decide.
    """
    measured = {(key.group, key.experiment, key.setting) for key in differences}
    lines = {
        f"{group.name}, {label}": (setting, group)
        for group in groups
        for setting, label in labelled_settings()
        if (group.name, setting.experiment, setting.name) in measured
    }
    size = (2 * _PANEL + 1.6, (_LINE * len(lines) + 0.9) * len(ways) + 1.0)
    title = "What color changes against FPFH alone on the same places, with 95 % intervals"
    figure = blank_figure(size, title, fontsize=12, columns=90)
    for way, (shares, errors) in zip(ways, figure.subplots(len(ways), 2, squeeze=False), strict=True):
        for y, (setting, group) in enumerate(lines.values()):
            for offset, method in zip(_OFFSETS, COMPARED, strict=True):
                change = differences.get(Key(setting.experiment, setting.name, group.name, way.name, method))
                if change is not None:
                    few = change.places < LEAST_PLACES
                    _bar(shares, y + offset, [100 * value for value in change.found], COLORS[method], few)
                    _bar(errors, y + offset, [1000 * value for value in change.rmse], COLORS[method], few)
        errors.set_xscale("symlog", linthresh=_LINEAR)
        _dress(shares, "share of runs found, % (to the right, color is better)", list(lines))
        _dress(errors, "RMSE, mm (to the left, color is better)", [""] * len(lines))
        shares.set_title(way.title, fontsize=10, loc="left")
    add_legend(figure, {method: COLORS[method] for method in COMPARED})
    return figure


def _dress(ax: Axes, words: str, names: Sequence[str]) -> None:
    """A line at zero, and the names of the lines, the first on top."""
    ax.axvline(0, color="0.3", linewidth=1)
    ax.set_xlabel(words, fontsize=9)
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.grid(axis="x", color="0.9")
    ax.tick_params(labelsize=8)


def _bar(ax: Axes, y: float, interval: Sequence[float], color: str, few: bool) -> None:
    """A dot with its interval; of too few places a hollow dot alone, since their interval means little."""
    value, low, high = interval
    if not few:
        ax.plot([low, high], [y, y], color=color, linewidth=2, solid_capstyle="butt")
    ax.plot(value, y, "o", color=color, markerfacecolor="white" if few else color, markersize=4.5)
