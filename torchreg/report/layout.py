"""Where the source stands in a picture of matches: the side to look from, and how far it is moved away."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.report.axes import AXES
from torchreg.report.scene import Scene
from torchreg.report.thinning import box
from torchreg.report.views import VIEWS, View

_WIDEST = 3.0  # times as wide as high: a wider pair is put one above the other
_GAP = 0.12  # between the clouds, of their extent
_EDGE = 0.1  # of the depth
_GRID = 100  # cells along the longest edge


class Layout(NamedTuple):
    """The side to look from, whether from behind it (up is down then), and where the source is moved, (3,) meters."""

    view: View
    behind: bool
    axis: int
    shift: NDArray[Any]


def layout_of(source: NDArray[Any], scene: Scene) -> Layout:
    """Look from the side from which the most surface is seen, and put the source on the left or above."""
    low, high = box(np.concatenate((source, scene.target)))
    size = high - low
    view = max(VIEWS, key=lambda view: _seen(scene.target[:, [view.right, view.up]], float(size.max())))
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


def placement(layout: Layout, *, found: bool) -> str:
    """What a reader must know of how the source is drawn."""
    sign = "-" if (layout.view.toward > 0) != layout.behind else ""
    how = "under the found transform" if found else "as it came, since no transform was found"
    moved = f"moved by {layout.shift[layout.axis]:.3g} m along {AXES[layout.axis]}"
    return f"seen along {sign}{AXES[layout.view.depth]}; the source is drawn {how}, {moved}"


def _from_behind(scene: Scene, view: View) -> bool:
    """Whether the scanner stood on the other side of all it saw, as a camera does, and the view is to be its own."""
    viewpoint = scene.clouds[1].viewpoint
    if viewpoint is None or len(scene.target) == 0:
        return False
    low, high = (float(corner[view.depth]) for corner in box(scene.target))
    place = float(viewpoint[0, view.depth])
    return place < low + _EDGE * (high - low) if view.toward > 0 else place > high - _EDGE * (high - low)


def _seen(flat: NDArray[Any], size: float) -> int:
    """How many cells of a picture (N, 2) hold points: a wall seen edge on fills few, one seen from before many."""
    cells = np.floor(flat / max(size / _GRID, 1e-12)).astype(np.int64)
    return len(np.unique(cells, axis=0))
