"""Pictures of a registration: the clouds before and after, from three sides, told apart and in true colors.

A grid of panels: a row for every side, a column for every state of the source.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import at_least, expect
from torchreg.report.canvas import add_legend, annotate, blank_figure, set_limits
from torchreg.report.scene import Scene, box, padded, scene_of, union
from torchreg.report.text import legible
from torchreg.report.views import VIEWS, View, axis_label, axis_words, slice_of, up_label, view_label
from torchreg.types import Clouds

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SOURCE_COLOR, TARGET_COLOR = "#d55e00", "#0072b2"
"""Vermilion and blue, which color-blind people tell apart (Okabe and Ito, Color Universal Design, 2008)."""

_RESERVE = 4  # times the points of a panel, since a slice takes a part of them
_WIDTH = 4.4  # inches of a column
_MARGIN = 0.04


class FigureColumn(NamedTuple):
    """One state: a heading, the source (N, 3) in the picture's frame, and whether to draw true colors."""

    heading: str
    source: NDArray[Any]
    in_color: bool = False


def registration_figure(
    source: Clouds,
    target: Clouds,
    T_target_source: Tensor | None,
    *,
    title: str = "",
    refused: bool = False,
    max_points: int = 20_000,
) -> Figure:
    """Draw two clouds before and after: a column each, from the top, the front and the side.

    Upright where up is known (``up_of``); elsewhere the three views are named by the axes that they look along.
    Orthographic, to scale, axes in meters by those of the target's frame. A closed room is cut open: its slice shows
    walls as lines, which lie on each other where the registration is right. The third column is the second in
    true colors, where both clouds have them. The same clouds give the same picture.

    Args:
        source: one cloud.
        target: one cloud.
        T_target_source: (4, 4), origins included; ``None`` draws the column before alone, where no pose was found.
        title: above all, such as ``picture_title`` words it.
        refused: whether the transform is only the likeliest one of a pair that was refused; its column says so.
        max_points: of each cloud in one panel.

    Returns:
        A matplotlib ``Figure`` on the Agg canvas, made without pyplot.

    Raises:
        ValueError: several clouds, another shape of transform, or ``max_points`` below 1.

    Example:
        >>> import torch
        >>> cloud = Clouds(torch.rand(100, 3))
        >>> len(registration_figure(cloud, cloud, torch.eye(4)).axes)
        6
    """
    scene = scene_of(source, target, _RESERVE * at_least(max_points, "max_points", 1))
    columns = [_before(scene)]
    if T_target_source is not None:
        columns.append(FigureColumn("likeliest pose, refused" if refused else "after", scene.moved(T_target_source)))
        columns += _true_colors(scene, columns[-1])
    return _draw_panels(scene, columns, columns[-1].source, title=title, max_points=max_points)


def demo_figure(
    source: Clouds,
    target: Clouds,
    transforms: Sequence[tuple[str, Tensor]],
    *,
    title: str = "",
    max_points: int = 20_000,
) -> Figure:
    """Draw the transforms of several methods for one pair side by side, after a column before.

    Args:
        source: one cloud.
        target: one cloud.
        transforms: heading and transform (4, 4) of every method; the last one is drawn in true colors too and
            decides where rooms are cut open.
        title: above all.
        max_points: of each cloud in one panel.

    Returns:
        A matplotlib ``Figure`` as ``registration_figure`` makes it.

    Raises:
        ValueError: as there, or no transform.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.report import demo_figure
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> figure = demo_figure(pair.source, pair.target, [("the truth", pair.T_target_source)])
    """
    expect(len(transforms) > 0, "transforms", "at least one method", transforms)
    scene = scene_of(source, target, _RESERVE * at_least(max_points, "max_points", 1))
    after = [FigureColumn(heading, scene.moved(T)) for heading, T in transforms]
    columns = [_before(scene), *after, *_true_colors(scene, after[-1])]
    return _draw_panels(scene, columns, after[-1].source, title=title, max_points=max_points)


def _before(scene: Scene) -> FigureColumn:
    source, distance = scene.unmoved()
    return FigureColumn(f"before (drawn together: {distance:,.0f} m apart)" if distance else "before", source)


def _true_colors(scene: Scene, column: FigureColumn) -> list[FigureColumn]:
    """The same state once more in the colors of the clouds, where both have them."""
    in_color = FigureColumn(f"{column.heading}, in true colors", column.source, in_color=True)
    return [] if scene.colors is None else [in_color]


def _draw_panels(
    scene: Scene, columns: Sequence[FigureColumn], reference: NDArray[Any], *, title: str, max_points: int
) -> Figure:
    """Draw every column from three sides, all panels of a row to the same scale.

    ``reference`` (N, 3) is the source in the state that decides which slices are cut, so that all columns show the
    same points.
    """
    shown = np.concatenate((reference, scene.target))  # (N + M, 3)
    least = padded(box(shown), _MARGIN)
    extent = least[1] - least[0]
    heights = [_WIDTH * float(np.clip(extent[view.up] / extent[view.right], 0.25, 1.0)) for view in VIEWS]
    size = (_WIDTH * len(columns), sum(heights) + 1.9)
    figure = blank_figure(size, title, fontsize=13, columns=40 * len(columns))
    axes = figure.subplots(len(VIEWS), len(columns), height_ratios=heights, squeeze=False)
    for view, height, row in zip(VIEWS, heights, axes, strict=True):
        plane, ratio = [view.right, view.up], height / _WIDTH
        cut = slice_of(shown, view)
        for column, ax in zip(columns, row, strict=True):
            points = np.concatenate((column.source, scene.target))
            keep = _kept(shown, view, cut, column.in_color)
            _scatter(ax, scene, points, keep, view, max_points, column.in_color)
            low, high = union(least, padded(box(points), _MARGIN))
            set_limits(ax, low[plane], high[plane], ratio)
            ax.tick_params(labelsize=8)
            ax.set_xlabel(axis_label(scene, view.right), fontsize=8)
        row[0].set_ylabel(f"{view_label(scene, view)}\n{axis_label(scene, view.up)}", fontsize=9)
        if cut is not None:
            depth = axis_words(scene.frame[view.depth])
            text = f"slice: {depth} from {cut[0]:.3g} to {cut[1]:.3g} m in the target's frame"
            annotate(row[0], text, (0.01, 0.02), xycoords="axes fraction", fontsize=7, color="0.3")
    for column, ax in zip(columns, axes[0], strict=True):
        ax.set_title(legible(column.heading), fontsize=11, parse_math=False)
    names = [f"{name}, {count:,} points" for name, count in zip(("source", "target"), scene.counts, strict=True)]
    add_legend(figure, dict(zip(names, (SOURCE_COLOR, TARGET_COLOR), strict=True)), title=up_label(scene))
    return figure


def _scatter(
    ax: Axes, scene: Scene, points: NDArray[Any], keep: NDArray[Any], view: View, max_points: int, in_color: bool
) -> None:
    """The kept points: of each cloud the first ``max_points``; mixed, so that neither cloud hides the other."""
    split = len(scene.source)
    count = 2 * max_points if in_color else max_points
    rows = np.concatenate((np.flatnonzero(keep[:split])[:count], split + np.flatnonzero(keep[split:])[:count]))
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
