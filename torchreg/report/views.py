"""Views: the three that a registration is drawn from, and the one that shows most of two clouds.

What stands between the viewer and the middle of a room is left out, so that walls and ceilings do not hide the rest.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.report.scene import Scene, box

_UP = 2  # the axis of the picture's frame that is up

_THICKNESS = 0.25  # of the depth
_DEEP = 0.6  # of the depth: a line of sight that meets points so far apart enters and leaves the scene
_CLOSED = 0.3  # of the lines of sight
_FLAT = 0.08  # of the wider edge seen: a depth below that is a wall with its noise and its niches
_SIGHT_CELLS = 24  # along each edge seen: one line of sight each
_WIDEST = 3.0  # times as wide as high: a wider pair is put one above the other
_GAP = 0.12  # between the clouds, of their extent
_SEEN_CELLS = 100  # along the longest edge


class View(NamedTuple):
    """A view: which axis of the picture's frame runs right, which up, and which towards the viewer.

    The three are a right-handed system, so that nothing is mirrored; ``toward`` is 1 where that coordinate grows
    towards the viewer, else -1.
    """

    name: str
    right: int
    up: int
    depth: int
    toward: int


VIEWS = (View("top", 0, 1, 2, 1), View("front", 0, 2, 1, -1), View("side", 1, 2, 0, 1))


class Layout(NamedTuple):
    """The view, and by how much the source is moved, and along which axis: (3,) meters in the picture's frame."""

    view: View
    axis: int
    shift: NDArray[Any]


def slice_of(points: NDArray[Any], view: View) -> tuple[float, float] | None:
    """The depths between which to draw, like a plan of a building, or ``None`` to draw all.

    A room seen from outside is a box: what is near hides what is far. It is one where lines of sight meet
    points at the near and at the far end. A facade, or a scan of one corner, is drawn whole.
    """
    if len(points) == 0:
        return None
    low, high = box(points)
    depth = float(high[view.depth] - low[view.depth])
    plane = [view.right, view.up]
    if depth <= _FLAT * float((high - low)[plane].max()):
        return None
    edge = np.maximum(high[plane] - low[plane], 1e-12) / _SIGHT_CELLS
    cell = np.clip((points[:, plane] - low[plane]) / edge, 0, _SIGHT_CELLS - 1).astype(np.int64)
    key = cell[:, 0] * _SIGHT_CELLS + cell[:, 1]
    near, far = np.full(_SIGHT_CELLS**2, -np.inf), np.full(_SIGHT_CELLS**2, np.inf)
    along = np.clip(points[:, view.depth], low[view.depth], high[view.depth])
    np.maximum.at(near, key, along)
    np.minimum.at(far, key, along)
    met = np.isfinite(near)
    if float((near[met] - far[met] > _DEEP * depth).mean()) < _CLOSED:
        return None
    middle, half = float(low[view.depth] + high[view.depth]) / 2, depth * _THICKNESS / 2
    return middle - half, middle + half


def axis_words(direction: NDArray[Any]) -> str:
    """A direction (3,) by the axes of the target's file: ``x``, ``-y``, or ``0.94 x - 0.33 z`` between them."""
    words = ""
    for value, name in zip(direction, "xyz", strict=True):
        if abs(value) >= 0.005:
            sign = ("-" if value < 0 else "") if not words else (" - " if value < 0 else " + ")
            words += sign + ("" if abs(value) > 0.99995 else f"{abs(value):.2f} ") + name
    return words


def axis_label(scene: Scene, axis: int) -> str:
    """An axis of the picture by those of the target's file, and its unit, with what is subtracted from large values.

    Up between the axes of the file is only called that: ``up_label`` says where it is.
    """
    direction = scene.frame[axis]
    if axis == _UP and not _is_axis(direction):
        return "up (m)"
    offset = float(direction @ scene.clouds[1].origin[0].cpu().numpy())
    shifted = f" {'-' if offset > 0 else '+'} {abs(offset):.0f}" if round(offset) else ""
    return f"{axis_words(direction)}{shifted} (m)"


def view_label(scene: Scene, view: View) -> str:
    """The view by name, where up is known, and the line of sight, where that is along an axis of the target's file."""
    direction = -view.toward * scene.frame[view.depth]
    name = "view" if scene.up.direction is None else f"{view.name} view"
    comma = "" if scene.up.direction is None else ","
    return f"{name}{comma} along {axis_words(direction)}" if _is_axis(direction) else name


def up_label(scene: Scene) -> str:
    """Which way is up, and from what that follows."""
    if scene.up.direction is None:
        return f"Which way is up is not known: {scene.up.reason}"
    return f"Up is {axis_words(scene.up.direction)}, from {scene.up.reason}"


def _is_axis(direction: NDArray[Any]) -> bool:
    return bool(np.abs(direction).max() > 0.99995)


def layout_of(source: NDArray[Any], scene: Scene) -> Layout:
    """The side from which the most surface is seen, with the source moved to the left of the target or above it."""
    low, high = box(np.concatenate((source, scene.target)))
    size = high - low
    view = max(VIEWS, key=lambda view: _cells_seen(scene.target[:, [view.right, view.up]], float(size.max())))
    beside = 2 * size[view.right] <= _WIDEST * size[view.up]
    axis = view.right if beside else view.up
    gap = _GAP * float(max(size[view.right], size[view.up]))
    shift = np.zeros(3)
    if beside:
        shift[axis] = box(scene.target)[0][axis] - box(source)[1][axis] - gap
    else:
        shift[axis] = box(scene.target)[1][axis] - box(source)[0][axis] + gap
    return Layout(view, axis, shift)


def _cells_seen(flat: NDArray[Any], size: float) -> int:
    """How many cells of a picture (N, 2) hold points: a wall seen edge on fills few, one seen from before many."""
    cells = np.floor(flat / max(size / _SEEN_CELLS, 1e-12)).astype(np.int64)
    return len(np.unique(cells, axis=0))
