"""A picture of the matches: both clouds apart, a line from each matched point to its partner."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import at_least
from torchreg.metrics.fit import relative_transform
from torchreg.report.axes import axis_label
from torchreg.report.layout import Layout, layout_of, placement
from torchreg.report.matched import drawn_matches, matched_points
from torchreg.report.scene import Scene, scene_of
from torchreg.report.text import legible, share
from torchreg.report.thinning import box
from torchreg.report.views import View, slice_of
from torchreg.types import Clouds, RegistrationResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INLIER_COLOR, OUTLIER_COLOR = "#009e73", "#cc79a7"
"""Bluish green and reddish purple, which color-blind people tell apart (Okabe and Ito, 2008)."""

_WIDTH, _HEIGHT = 8.2, 7.5  # inches of the panel at most
_MARGIN = 0.05
_PALER = 0.4  # of the way to white, so that lines stand out from the points
_INK = 150_000  # square points of all markers together
_GRAYS = (0.35, 0.85)  # of points without color: near and far


def correspondence_figure(
    source: Clouds,
    target: Clouds,
    result: RegistrationResult,
    pair: int = 0,
    *,
    title: str = "",
    max_matches: int = 120,
    max_points: int = 40_000,
) -> Figure:
    """Draw the matches of one pair between its clouds, inliers and outliers told apart.

    The source is drawn under the found transform and then moved away from the target, to its left or above it, so
    that the lines of right matches are parallel. Without a transform it is drawn as it came. Orthographic, from the
    side where most is seen, to scale, axes in meters in the target's frame; a closed room is drawn opened. Points
    have their colors, a little paler, or grays by depth. The same clouds give the same picture.

    Args:
        source: the B clouds that were registered, as they were given to ``register`` (or ``ransac``).
        target: likewise.
        result: of these B pairs.
        pair: which one.
        title: above all.
        max_matches: lines at most, spread over the source; the legend has the full counts.
        max_points: of each cloud.

    Returns:
        A matplotlib ``Figure`` on the Agg canvas, made without pyplot.

    Raises:
        ValueError: clouds that the result does not speak of, a ``pair`` out of range, or a count below 1.

    Example:
        >>> import torchreg as tr
        >>> scans = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> result = tr.register(scans.source, scans.target)
        >>> figure = correspondence_figure(scans.source, scans.target, result)
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    at_least(max_matches, "max_matches", 1)
    matched = matched_points(source, target, result, pair)
    scene = scene_of(source.select(pair), target.select(pair), at_least(max_points, "max_points", 1))
    T = result.T_target_source[pair].detach() if bool(result.success[pair]) else None
    R, t = _motion(scene, T)
    placed = scene.source @ R.T + t
    layout = layout_of(placed, scene)

    low, high = _frame(placed + layout.shift, scene.target, layout.view)
    ratio = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.2, 1.2))
    width = min(_WIDTH, _HEIGHT / ratio)
    figure = Figure(figsize=(width + 0.8, width * ratio + 1.4), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(textwrap.fill(legible(title), 90), fontsize=12, parse_math=False)
    ax = figure.subplots()
    _draw_points(ax, scene, placed, layout)
    starts = matched.source @ R.T + t + layout.shift
    total = len(matched.inlier)
    kinds = zip(
        ("inliers", "outliers"), (INLIER_COLOR, OUTLIER_COLOR), drawn_matches(matched, max_matches), strict=True
    )
    for name, color, rows in kinds:
        count = int(matched.inlier.sum()) if name == "inliers" else int((~matched.inlier).sum())
        label = f"{name}: {share(count, total)}" + (f", {len(rows)} drawn" if len(rows) < count else "")
        _draw_lines(ax, starts[rows], matched.target[rows], layout.view, color, label)
    vertical = (high[1], low[1]) if layout.behind else (low[1], high[1])
    ax.set(xlim=(low[0], high[0]), ylim=vertical, aspect="equal")
    _name(ax, "source", placed + layout.shift, layout)
    _name(ax, "target", scene.target, layout)
    ax.set_xlabel(axis_label(scene, layout.view.right), fontsize=9)
    ax.set_ylabel(axis_label(scene, layout.view.up), fontsize=9)
    ax.tick_params(labelsize=8)
    ax.set_title(placement(layout, found=T is not None), fontsize=9, color="0.3")
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=10)
    return figure


def _motion(scene: Scene, T: Tensor | None) -> tuple[NDArray[Any], NDArray[Any]]:
    """Rotation (3, 3) and translation (3,) from the source's points to the target's; without T, center on center."""
    if T is None:
        low, high = (there - here for there, here in zip(box(scene.target), box(scene.source), strict=True))
        return np.eye(3), (low + high) / 2
    one, other = scene.clouds
    R, t = relative_transform(one, other, T.to(one.device)[None])
    return R[0].cpu().numpy(), t[0].cpu().numpy()


def _frame(source: NDArray[Any], target: NDArray[Any], view: View) -> tuple[NDArray[Any], NDArray[Any]]:
    corners = [box(points) for points in (source, target)]
    low, high = np.minimum(corners[0][0], corners[1][0]), np.maximum(corners[0][1], corners[1][1])
    pad = max(_MARGIN * float((high - low).max()), 1e-6)
    plane = [view.right, view.up]
    return low[plane] - pad, high[plane] + pad


def _draw_points(ax: Axes, scene: Scene, placed: NDArray[Any], layout: Layout) -> None:
    """Both clouds, far points first; of a closed room what lies behind the middle, as in an opened doll's house."""
    view = layout.view
    aligned = np.concatenate((placed, scene.target))
    toward = -view.toward if layout.behind else view.toward
    nearness = toward * aligned[:, view.depth]
    cut = slice_of(aligned, view)
    rows = np.arange(len(aligned)) if cut is None else np.flatnonzero(nearness <= max(toward * np.array(cut)))
    rows = rows[np.argsort(nearness[rows], kind="stable")]
    if scene.colors is None:
        depth = np.linspace(0, 1, len(rows))[:, None]  # by rank, so that stray points do not use up the grays
        color = _GRAYS[1] + (_GRAYS[0] - _GRAYS[1]) * depth * np.ones(3)
    else:
        color = scene.colors[rows]
    color = color + _PALER * (1 - color)
    drawn = np.concatenate((placed + layout.shift, scene.target))[rows]
    size = float(np.clip(_INK / max(len(rows), 1), 1.0, 20.0))
    ax.scatter(drawn[:, view.right], drawn[:, view.up], s=size, c=color, marker="s", linewidths=0, rasterized=True)


def _name(ax: Axes, name: str, points: NDArray[Any], layout: Layout) -> None:
    """What a cloud is, at its upper left corner."""
    low, high = box(points)
    view = layout.view
    corner = (low[view.right], low[view.up] if layout.behind else high[view.up])
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    ax.annotate(name, corner, fontsize=11, fontweight="bold", va="bottom", bbox=paper, zorder=5)


def _draw_lines(ax: Axes, starts: NDArray[Any], ends: NDArray[Any], view: View, color: str, label: str) -> None:
    from matplotlib.collections import LineCollection

    plane = [view.right, view.up]
    lines = np.stack((starts[:, plane], ends[:, plane]), axis=1)  # (L, 2, 2)
    strong = color == INLIER_COLOR
    style: dict[str, Any] = {"linewidths": 0.8, "alpha": 0.9} if strong else {"linewidths": 0.7, "alpha": 0.75}
    ax.add_collection(LineCollection(list(lines), colors=color, zorder=3 if strong else 2, label=label, **style))
    ends_of_lines = lines.reshape(-1, 2)
    ax.scatter(ends_of_lines[:, 0], ends_of_lines[:, 1], s=3, c=color, linewidths=0, zorder=4)
