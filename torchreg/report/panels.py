"""A grid of panels: a row for every side, a column for every state of the source."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.report.axes import AXES, axis_label, note
from torchreg.report.scene import Scene
from torchreg.report.text import legible
from torchreg.report.thinning import box
from torchreg.report.views import VIEWS, View, slice_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SOURCE_COLOR, TARGET_COLOR = "#d55e00", "#0072b2"
"""Vermilion and blue, which color-blind people tell apart (Okabe and Ito, Color Universal Design, 2008)."""

_WIDTH = 4.4  # inches of a column
_MARGIN = 0.04


class Column(NamedTuple):
    """One state: a heading, the source (N, 3) in the picture's frame, and whether to draw true colors."""

    heading: str
    source: NDArray[Any]
    in_color: bool = False


def draw_panels(
    scene: Scene, columns: Sequence[Column], reference: NDArray[Any], *, title: str, max_points: int
) -> Figure:
    """Draw every column from three sides, all panels of a row to the same scale.

    Args:
        scene: the clouds.
        columns: from left to right.
        reference: (N, 3) the source in the state that decides which slices are cut; the points of the slices
            are then the same in all columns.
        title: above all.
        max_points: of each cloud in one panel.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = np.concatenate((reference, scene.target))  # (N + M, 3)
    least = _padded(*box(shown))
    heights = [_WIDTH * float(np.clip(_aspect(view, *least), 0.25, 1.0)) for view in VIEWS]
    size = (_WIDTH * len(columns), sum(heights) + 1.9)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(textwrap.fill(legible(title), 40 * len(columns)), fontsize=13, parse_math=False)
    axes = figure.subplots(len(VIEWS), len(columns), height_ratios=heights, squeeze=False)
    for view, height, row in zip(VIEWS, heights, axes, strict=True):
        plane, ratio = [view.right, view.up], height / _WIDTH
        cut = slice_of(shown, view)
        for column, ax in zip(columns, row, strict=True):
            points = np.concatenate((column.source, scene.target))
            keep = _kept(shown, view, cut, column.in_color)
            _scatter(ax, scene, points, keep, view, max_points, column.in_color)
            low, high = _union(least, _padded(*box(points)))
            _set_limits(ax, low[plane], high[plane], ratio)
            ax.tick_params(labelsize=8)
            ax.set_xlabel(axis_label(scene, view.right), fontsize=8)
        row[0].set_ylabel(f"{view.name} view, along {AXES[view.depth]}\n{axis_label(scene, view.up)}", fontsize=9)
        if cut is not None:
            note(row[0], f"slice: {AXES[view.depth]} from {cut[0]:.3g} to {cut[1]:.3g} m in the target's frame")
    for column, ax in zip(columns, axes[0], strict=True):
        ax.set_title(legible(column.heading), fontsize=11, parse_math=False)
    _legend(figure, scene)
    return figure


def _scatter(
    ax: Axes, scene: Scene, points: NDArray[Any], keep: NDArray[Any], view: View, max_points: int, in_color: bool
) -> None:
    """The kept points: of each cloud the first ``max_points``; mixed, so that neither cloud hides the other."""
    split = len(scene.source)
    count = 2 * max_points if in_color else max_points
    own, other = np.flatnonzero(keep[:split])[:count], split + np.flatnonzero(keep[split:])[:count]
    rows = np.concatenate((own, other))
    if in_color and scene.colors is not None:
        rows = rows[np.argsort(view.toward * points[rows, view.depth], kind="stable")]  # far before near
        color: Any = scene.colors[rows]
    else:
        rows = np.random.default_rng(0).permutation(rows)
        color = np.where(rows < split, SOURCE_COLOR, TARGET_COLOR)
    size = float(np.clip(12_000 / max(len(rows), 1), 0.7, 20.0)) * (3.0 if in_color else 1.0)
    x, y = points[rows, view.right], points[rows, view.up]
    ax.scatter(x, y, s=size, c=color, marker="s", linewidths=0, rasterized=True, in_layout=False)


def _kept(points: NDArray[Any], view: View, cut: tuple[float, float] | None, in_color: bool) -> NDArray[Any]:
    """(N + M,) bool: the slice; in true colors all that lies behind its near face, as in an opened doll's house."""
    if cut is None:
        return np.ones(len(points), dtype=bool)
    depth = points[:, view.depth]
    if in_color:
        return np.asarray(depth <= cut[1] if view.toward > 0 else depth >= cut[0])
    return np.asarray((depth >= cut[0]) & (depth <= cut[1]))


def _padded(low: NDArray[Any], high: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    pad = max(float((high - low).max()) * _MARGIN, 1e-6)
    return low - pad, high + pad


def _union(
    one: tuple[NDArray[Any], NDArray[Any]], other: tuple[NDArray[Any], NDArray[Any]]
) -> tuple[NDArray[Any], NDArray[Any]]:
    return np.minimum(one[0], other[0]), np.maximum(one[1], other[1])


def _aspect(view: View, low: NDArray[Any], high: NDArray[Any]) -> float:
    size = high - low
    return float(size[view.up] / size[view.right])


def _set_limits(ax: Axes, low: NDArray[Any], high: NDArray[Any], ratio: float) -> None:
    """Show at least from ``low`` to ``high`` (2,), to scale, in a panel ``ratio`` times as high as wide."""
    size = high - low
    shown = np.array([max(size[0], size[1] / ratio), max(size[1], size[0] * ratio)])
    middle = (low + high) / 2
    ax.set_xlim(middle[0] - shown[0] / 2, middle[0] + shown[0] / 2)
    ax.set_ylim(middle[1] - shown[1] / 2, middle[1] + shown[1] / 2)
    ax.set_aspect("equal")


def _legend(figure: Figure, scene: Scene) -> None:
    from matplotlib.lines import Line2D

    marks = [
        Line2D([], [], linestyle="", marker="o", markersize=7, color=color, label=f"{name}, {count:,} points")
        for name, color, count in zip(("source", "target"), (SOURCE_COLOR, TARGET_COLOR), scene.counts, strict=True)
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=2, frameon=False, fontsize=10)
