"""Fewer points for a picture: even in space, and the same ones every time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_SEED = 0
_CELLS = 400  # along the longest edge: about the pixels of one panel
_FEW = 1000


def thin(points: NDArray[Any], count: int) -> NDArray[np.int64]:
    """Rows of at most ``count`` finite points, spread over the space that they fill, in a shuffled order.

    A scanner puts most points right beside itself, so a plain random choice would leave the far walls empty:
    every small cube gives one point before any gives a second.

    Args:
        points: (N, 3).
        count: how many stay.

    Returns:
        (K,) int64, K <= count. The order is shuffled, so its first part is as even as the whole.
    """
    order = np.random.default_rng(_SEED).permutation(np.flatnonzero(np.isfinite(points).all(axis=1)))
    if len(order) <= count:
        return order
    low, high = box(points[order])
    edge = max(float((high - low).max()), 1e-12) / _CELLS
    cell = np.clip((points[order] - low) / edge, -_CELLS, 2 * _CELLS).astype(np.int64) + _CELLS  # (N, 3)
    key = (cell[:, 0] * 4 * _CELLS + cell[:, 1]) * 4 * _CELLS + cell[:, 2]
    first = np.zeros(len(order), dtype=bool)
    first[np.unique(key, return_index=True)[1]] = True
    return np.concatenate((order[first], order[~first]))[:count]


def box(points: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The lowest and highest corner (D,) of what most points (N, D) fill: a few stray ones do not count."""
    if len(points) == 0:
        return np.zeros(points.shape[1]), np.ones(points.shape[1])
    if len(points) < _FEW:
        return points.min(axis=0), points.max(axis=0)
    low, high = np.quantile(points, (0.002, 0.998), axis=0)
    return low, high
