"""Three sides to look from, and what to leave out so that walls and ceilings do not hide the rest."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.report.thinning import box

_THICKNESS = 0.25  # of the depth
_DEEP = 0.6  # of the depth: a line of sight that meets points so far apart enters and leaves the scene
_CLOSED = 0.3  # of the lines of sight
_FLAT = 0.08  # of the wider edge seen: a depth below that is a wall with its noise and its niches
_GRID = 24


class View(NamedTuple):
    """A side to look from: which coordinate runs right, which up, and which towards the viewer.

    ``toward`` is 1 where that coordinate grows towards the viewer, else -1.
    """

    name: str
    right: int
    up: int
    depth: int
    toward: int


VIEWS = (View("top", 0, 1, 2, 1), View("front", 0, 2, 1, -1), View("side", 1, 2, 0, 1))


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
    edge = np.maximum(high[plane] - low[plane], 1e-12) / _GRID
    cell = np.clip((points[:, plane] - low[plane]) / edge, 0, _GRID - 1).astype(np.int64)
    key = cell[:, 0] * _GRID + cell[:, 1]
    near, far = np.full(_GRID**2, -np.inf), np.full(_GRID**2, np.inf)
    along = np.clip(points[:, view.depth], low[view.depth], high[view.depth])
    np.maximum.at(near, key, along)
    np.minimum.at(far, key, along)
    met = np.isfinite(near)
    if float((near[met] - far[met] > _DEEP * depth).mean()) < _CLOSED:
        return None
    middle, half = float(low[view.depth] + high[view.depth]) / 2, depth * _THICKNESS / 2
    return middle - half, middle + half
