"""Views: the three that a registration is drawn from, and the one that shows most of two clouds.

What stands between the viewer and the middle of a room is left out, so that walls and ceilings do not hide the rest.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.report.scene import Scene, box

AXES = "xyz"

_THICKNESS = 0.25  # of the depth
_DEEP = 0.6  # of the depth: a line of sight that meets points so far apart enters and leaves the scene
_CLOSED = 0.3  # of the lines of sight
_FLAT = 0.08  # of the wider edge seen: a depth below that is a wall with its noise and its niches
_SIGHT_CELLS = 24  # along each edge seen: one line of sight each
_WIDEST = 3.0  # times as wide as high: a wider pair is put one above the other
_GAP = 0.12  # between the clouds, of their extent
_EDGE = 0.1  # of the depth
_SEEN_CELLS = 100  # along the longest edge


class View(NamedTuple):
    """A view: which coordinate runs right, which up, and which towards the viewer.

    ``toward`` is 1 where that coordinate grows towards the viewer, else -1.
    """

    name: str
    right: int
    up: int
    depth: int
    toward: int


VIEWS = (View("top", 0, 1, 2, 1), View("front", 0, 2, 1, -1), View("side", 1, 2, 0, 1))


class Layout(NamedTuple):
    """The view, whether from behind (up is down then), and by how much the source is moved, (3,) meters."""

    view: View
    behind: bool
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


def axis_label(scene: Scene, axis: int) -> str:
    """A coordinate of the target's frame and its unit, with what is subtracted from large values."""
    origin = float(scene.clouds[1].origin[0, axis])
    return f"{AXES[axis]} - {origin:.0f} (m)" if origin else f"{AXES[axis]} (m)"


def layout_of(source: NDArray[Any], scene: Scene) -> Layout:
    """The side from which the most surface is seen, with the source moved to the left of the target or above it."""
    low, high = box(np.concatenate((source, scene.target)))
    size = high - low
    view = max(VIEWS, key=lambda view: _cells_seen(scene.target[:, [view.right, view.up]], float(size.max())))
    behind = _from_behind(scene, view)
    beside = 2 * size[view.right] <= _WIDEST * size[view.up]
    axis = view.right if beside else view.up
    gap = _GAP * float(max(size[view.right], size[view.up]))
    shift = np.zeros(3)
    if beside or behind:
        shift[axis] = box(scene.target)[0][axis] - box(source)[1][axis] - gap
    else:
        shift[axis] = box(scene.target)[1][axis] - box(source)[0][axis] + gap
    return Layout(view, behind, axis, shift)


def _from_behind(scene: Scene, view: View) -> bool:
    """Whether the scanner stood on the far side of all it saw, as a camera does: the view is then from there.

    A guess will do for a picture: the viewpoint counts whether it is known or assumed.
    """
    viewpoint = scene.clouds[1].viewpoint
    if viewpoint is None or len(scene.target) == 0:
        return False
    low, high = (float(corner[view.depth]) for corner in box(scene.target))
    place = float(viewpoint[0, view.depth])
    return place < low + _EDGE * (high - low) if view.toward > 0 else place > high - _EDGE * (high - low)


def _cells_seen(flat: NDArray[Any], size: float) -> int:
    """How many cells of a picture (N, 2) hold points: a wall seen edge on fills few, one seen from before many."""
    cells = np.floor(flat / max(size / _SEEN_CELLS, 1e-12)).astype(np.int64)
    return len(np.unique(cells, axis=0))
