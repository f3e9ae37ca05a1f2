"""A picture of the matches: both clouds apart, a line from each matched point to its partner."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.errors import at_least, expect, expect_in_words
from torchreg.report.canvas import annotate, below_figure, blank_figure
from torchreg.report.scene import Scene, box, padded, scene_of, thin, union
from torchreg.report.text import share
from torchreg.report.views import Layout, View, axis_label, layout_of, slice_of, up_label, view_label
from torchreg.types import Clouds, RegistrationResult
from torchreg.types.packing import spans
from torchreg.verification.likeliest import likeliest_pose

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


class MatchEnds(NamedTuple):
    """Where the matches of one pair begin and end."""

    source: NDArray[Any]  # (M, 3) float64, meters, relative to the source's origin
    target: NDArray[Any]  # (M, 3) float64, meters, relative to the target's origin
    inlier: NDArray[Any]  # (M,) bool


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

    The source is drawn under the transform of the result, or the likeliest one of a refused pair, and then moved away
    from the target, to its left or above it, so that the lines of right matches are parallel. Without a transform it
    is drawn as it came. Orthographic, from the side where most is seen, upright where up is known (``up_of``), to
    scale, axes in meters by those of the target's frame; a closed room is drawn opened. Points have their colors, a
    little paler, or grays by depth. The same clouds give the same picture.

    The points drawn are those of the clouds given here, which are denser than the thinned ones that were matched
    and are there for a refused pair as well. The lines run between points of ``result.source`` and ``result.target``.

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
        ValueError: another number of clouds or other origins than the result's, a ``pair`` out of range, or a count
            below 1.

    Example:
        >>> import torchreg as tr
        >>> scans = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> result = tr.register(scans.source, scans.target)
        >>> figure = correspondence_figure(scans.source, scans.target, result)
    """
    at_least(max_matches, "max_matches", 1)
    expect(0 <= pair < len(result), "pair", f"a number from 0 to {len(result) - 1}", pair)
    for name, clouds, matched in (("source", source, result.source), ("target", target, result.target)):
        expected = f"the {len(result)} clouds that were registered"
        expect_in_words(len(clouds) == len(result), name, expected, f"{len(clouds)} clouds")
        expect_in_words(
            bool((clouds.origin.cpu() == matched.origin.cpu()).all()), name, expected, "clouds of other origins"
        )
    scene = scene_of(source.select(pair), target.select(pair), at_least(max_points, "max_points", 1))
    ends = match_ends(result, pair)
    T = likeliest_pose(result, pair)
    if T is not None:
        placed, starts = scene.moved(T), scene.moved(T, ends.source)
        success = bool(result.success[pair])
        pose = "under the transform of the result" if success else "under the likeliest transform, which was refused"
    else:
        as_it_came, starts = scene.turned(scene.source), scene.turned(ends.source)
        low, high = (there - here for there, here in zip(box(scene.target), box(as_it_came), strict=True))
        placed, starts = (points + (low + high) / 2 for points in (as_it_came, starts))  # center on center
        pose = "as it came, since no pose was found"
    layout = layout_of(placed, scene)
    view, moved = layout.view, placed + layout.shift

    low, high = (corner[[view.right, view.up]] for corner in padded(union(box(moved), box(scene.target)), _MARGIN))
    ratio = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.2, 1.2))
    width = min(_WIDTH, _HEIGHT / ratio)
    figure = blank_figure((width + 0.8, width * ratio + 1.9), title, fontsize=12, columns=90)
    ax = figure.subplots()
    _draw_points(ax, scene, placed, layout)
    kinds = (("inliers", INLIER_COLOR, ends.inlier), ("outliers", OUTLIER_COLOR, ~ends.inlier))
    for (name, color, those), rows in zip(kinds, drawn_matches(ends, max_matches), strict=True):
        count = int(those.sum())
        label = f"{name}: {share(count, len(those))}" + (f", {len(rows)} drawn" if len(rows) < count else "")
        _draw_lines(ax, starts[rows] + layout.shift, scene.turned(ends.target[rows]), view, color, label)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    for name, points in (("source", moved), ("target", scene.target)):
        upper_left = (box(points)[0][view.right], box(points)[1][view.up])
        annotate(ax, name, upper_left, fontsize=11, fontweight="bold", va="bottom", zorder=5)
    ax.set_xlabel(axis_label(scene, view.right), fontsize=9)
    ax.set_ylabel(axis_label(scene, view.up), fontsize=9)
    ax.tick_params(labelsize=8)
    distance = layout.shift[layout.axis]
    aside = f"moved {abs(distance):.3g} m {'to the left' if layout.axis == view.right else 'up'}"
    ax.set_title(f"{view_label(scene, view)}; the source is drawn {pose}, {aside}", fontsize=9, color="0.3")
    below_figure(figure, title=up_label(scene), ncols=2)
    return figure


def match_ends(result: RegistrationResult, pair: int) -> MatchEnds:
    """Look up both ends of every match of one pair in the clouds that the result matched."""
    begin, end = spans(result.correspondences.offsets)[pair]
    sides = (
        (result.source.points, result.correspondences.source),
        (result.target.points, result.correspondences.target),
    )
    source, target = (points.detach()[rows[begin:end]].cpu().double().numpy() for points, rows in sides)
    return MatchEnds(source, target, result.inliers[begin:end].cpu().numpy())


def drawn_matches(ends: MatchEnds, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which inliers and which outliers to draw, at most ``count`` together, spread over the source.

    Each kind gets its share of the matches, yet at least a fifth where it has as many, so that neither goes unseen.
    The same matches give the same choice.
    """
    kinds = [np.flatnonzero(ends.inlier), np.flatnonzero(~ends.inlier)]
    total = max(len(ends.inlier), 1)
    least = [min(len(rows), -(-count // 5)) for rows in kinds]
    first = min(max(round(count * len(kinds[0]) / total), least[0]), count - least[1])
    quota = (first, count - first)
    inlier, outlier = (rows[thin(ends.source[rows], most)] for rows, most in zip(kinds, quota, strict=True))
    return inlier, outlier


def _draw_points(ax: Axes, scene: Scene, placed: NDArray[Any], layout: Layout) -> None:
    """Both clouds, far points first; of a closed room what lies behind the middle, as in an opened doll's house."""
    view = layout.view
    aligned = np.concatenate((placed, scene.target))
    nearness = view.toward * aligned[:, view.depth]
    cut = slice_of(aligned, view)
    rows = np.arange(len(aligned)) if cut is None else np.flatnonzero(nearness <= max(view.toward * np.array(cut)))
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


def _draw_lines(ax: Axes, starts: NDArray[Any], ends: NDArray[Any], view: View, color: str, label: str) -> None:
    from matplotlib.collections import LineCollection

    plane = [view.right, view.up]
    lines = np.stack((starts[:, plane], ends[:, plane]), axis=1)  # (L, 2, 2)
    strong = color == INLIER_COLOR
    style: dict[str, Any] = {"linewidths": 0.8, "alpha": 0.9} if strong else {"linewidths": 0.7, "alpha": 0.75}
    ax.add_collection(LineCollection(list(lines), colors=color, zorder=3 if strong else 2, label=label, **style))
    tips = lines.reshape(-1, 2)
    ax.scatter(tips[:, 0], tips[:, 1], s=3, c=color, linewidths=0, zorder=4)
