"""Charts: the errors of every setting and method, one dot per place, and the paper's printed number."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.paper.methods import METHODS
from torchreg.benchmark.paper.places import PlaceGroup
from torchreg.benchmark.paper.printed import ERRORS, SECONDS
from torchreg.benchmark.paper.settings import settings_of
from torchreg.benchmark.paper.summary import error
from torchreg.benchmark.paper.tables import LABELS
from torchreg.benchmark.paper.times import SPANS, TIMED
from torchreg.benchmark.paper.ways import Procedure
from torchreg.report.canvas import add_legend, blank_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = dict(zip(METHODS, ("#0072b2", "#d55e00", "#cc79a7"), strict=True))
"""Blue, vermilion and purple, which color-blind people tell apart (Okabe and Ito, 2008)."""

_PANEL = (4.4, 2.9)  # inches
_AXIS_NAMES = {1: "initial pose", 2: "points", 3: "points", 5: "scene"}
_BAR = 0.8 / len(METHODS)
_LEAST = 1e-4  # drawn for an error of zero, since the axis is logarithmic


def errors_chart(experiment: int, lines: Sequence[tuple[PlaceGroup, Procedure]], rows: Sequence[Row]) -> Figure:
    """RRE, RTE and RMSE of experiment 1, 2, 3 or 5: a row of panels for each group and way, the first on top."""
    settings = [setting.name for setting in settings_of(experiment)]
    title = f"Experiment {experiment}: dots are places, bars their median"
    figure = _figure(len(LABELS), len(lines), title, METHODS)
    panels = figure.subplots(len(lines), len(LABELS), squeeze=False)
    for (group, way), row in zip(lines, panels, strict=True):
        names = (experiment, group.name, way.name)
        of_group = [one for one in rows if (one["experiment"], one["group"], one["way"]) == names]
        for (measure, label), ax in zip(LABELS.items(), row, strict=True):
            _error_panel(ax, settings, of_group, measure)
            if not group.real:
                _printed(ax, experiment, settings, measure)
            _logarithmic(ax)
            ax.set_ylabel(label.replace("/", " in "), fontsize=9)
            ax.set_xlabel(_AXIS_NAMES[experiment], fontsize=9)
        row[0].set_title(f"{group.title}; {way.title}", fontsize=10, loc="left")
    return figure


def times_chart(rows: Sequence[Row]) -> Figure:
    """Times of Experiment 4 over the number of points, a panel for every span."""
    title = "Experiment 4: times (the paper does not say which span its numbers cover)"
    figure = _figure(len(SPANS), 1, title, TIMED)
    names = {row["setting"]: row for row in rows}
    for span, ax in zip(SPANS, figure.subplots(1, len(SPANS), sharey=True), strict=True):
        for method in TIMED:
            points = [row["points"] for row in names.values()]
            ours = [median(row["seconds"][f"{span}/{method}"]) for row in names.values()]
            ax.plot(points, ours, "o-", color=COLORS[method], markersize=5)
            paper = [SECONDS[name, method] for name in names]
            ax.plot(points, paper, "D", color=COLORS[method], markeredgecolor="black", markersize=6)
        ax.set(xscale="log", yscale="log")
        ax.set_xticks([row["points"] for row in names.values()], [f"{row['points']:,}" for row in names.values()])
        ax.minorticks_off()
        ax.set_title(span, fontsize=10)
        ax.set_xlabel("points of a cloud", fontsize=9)
        ax.grid(axis="y", color="0.9")
    figure.axes[0].set_ylabel("seconds", fontsize=9)
    return figure


def _error_panel(ax: Axes, settings: Sequence[str], rows: Sequence[Row], measure: str) -> None:
    for place, name in enumerate(settings):
        for method in METHODS:
            x = _across(place, method)
            here = [row for row in rows if (row["setting"], row["method"]) == (name, method)]
            errors = [max(error(row, measure), _LEAST) for row in here]
            if errors:
                spread = np.linspace(-0.35, 0.35, len(errors)) * _BAR if len(errors) > 1 else np.zeros(1)
                ax.plot(x + spread, sorted(errors), "o", color=COLORS[method], markersize=3.0, alpha=0.6)
                ax.plot([x - 0.4 * _BAR, x + 0.4 * _BAR], [median(errors)] * 2, color=COLORS[method], linewidth=2)
    ax.set_xticks(range(len(settings)), settings)
    ax.set_xlim(-0.6, len(settings) - 0.4)
    ax.tick_params(labelsize=8)
    ax.grid(axis="y", color="0.9")


def _printed(ax: Axes, experiment: int, settings: Sequence[str], measure: str) -> None:
    """The paper's numbers."""
    for place, name in enumerate(settings):
        for method in METHODS:
            printed = ERRORS.get((experiment, name, method))
            if printed is not None:
                value = getattr(printed, measure)
                ax.plot(_across(place, method), value, "D", color=COLORS[method], markeredgecolor="black", markersize=6)


def _across(place: int, method: str) -> float:
    """The abscissa of a method among those of one setting."""
    return place + (METHODS.index(method) - (len(METHODS) - 1) / 2) * _BAR


def _logarithmic(ax: Axes) -> None:
    """Errors from millimeters to meters on one axis, marked with plain numbers."""
    from matplotlib.ticker import LogLocator, NullLocator

    ax.set_yscale("log")
    low, high = ax.get_ylim()
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 300 * low else (1.0,), numticks=20))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter("{x:g}")


def _figure(columns: int, rows: int, title: str, methods: Sequence[str]) -> Figure:
    """A blank figure for so many panels, with a legend of methods and of the paper's numbers."""
    from matplotlib.lines import Line2D

    size = (_PANEL[0] * columns, _PANEL[1] * rows + 1.1)
    figure = blank_figure(size, title, fontsize=12, columns=30 * columns)
    style: dict[str, Any] = {"linestyle": "", "marker": "D", "color": "white", "markeredgecolor": "black"}
    add_legend(figure, {name: COLORS[name] for name in methods}, Line2D([], [], label="the paper's number", **style))
    return figure
