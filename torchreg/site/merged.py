"""The scans of a site as one cloud, each cube of a grid one point, and which scan a point comes from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import at_least, expect, positive
from torchreg.geometry.morton import morton_order
from torchreg.geometry.se3 import transform
from torchreg.site.result import SiteResult
from torchreg.types import Clouds

_GRAY = 0.5
"""Of points without a color beside some with one."""

_BITS = 21  # of the number of a cube along each axis
_HALF = 1 << (_BITS - 1)
_MERGE_ROWS = 1 << 19  # fewest cubes of new scans that are put among the others at once


class MergedCloud(NamedTuple):
    """The scans of a group as one cloud."""

    cloud: Clouds
    """A batch of one, in the frame of the group and in Z order, without a scanner or normals."""

    scan: Tensor
    """(P,) int64, the number of the scan that gave most of what a point is the mean of."""


def merged_cloud(scans: Sequence[Clouds], site: SiteResult, *, spacing: float, group: int = 0) -> MergedCloud:
    """Put the scans of one group into one cloud, thinned: the mean of the points in every cube of one grid.

    Scans are asked for one after another and added to the cubes, so memory is for the cubes and one scan. Scans without
    colors are gray beside colored ones.

    Args:
        scans: the N scans that were placed, each a batch of one; a sequence may read them when they are asked for.
        site: where they are.
        spacing: meters, the edge of the cubes.
        group: which group.

    Raises:
        ValueError: another number of scans, a group without scans, a spacing that is not above 0 or too small for the
            extent.
    """
    positive(spacing, "spacing")
    at_least(group, "group", 0)
    expect(len(scans) == len(site), "scans", f"the {len(site)} scans of the site", len(scans))
    members = (site.group == group).nonzero()[:, 0].tolist()
    expect(len(members) > 0, "group", f"one of {int(site.group.max()) + 1} groups", group)
    cubes = _Cubes(spacing)
    origin = torch.zeros(1, 3, dtype=torch.float64)
    for place, scan in enumerate(members):
        own = scans[scan].detach().to(device="cpu")
        bare = Clouds(own.points.double(), origin=own.origin)
        moved = transform(bare, site.T_world_scan[scan])
        origin = moved.origin.round() if place == 0 else origin
        colors = None if own.colors is None else own.colors.numpy()
        cubes.add((moved.points + (moved.origin - origin)).numpy(), colors, scan)
    kept = cubes.take()
    points = torch.from_numpy(kept.points).float()
    order = morton_order(points, torch.tensor([0, len(points)]))
    painted = None if kept.colors is None else torch.from_numpy(kept.colors).float()[order]
    return MergedCloud(
        Clouds(points[order], colors=painted, origin=origin), torch.from_numpy(kept.scan.astype(np.int64))[order]
    )


class _Selected(NamedTuple):
    points: NDArray[Any]  # (K, 3) float64
    colors: NDArray[Any] | None  # (K, 3) float64
    scan: NDArray[Any]  # (K,)


class _Sums(NamedTuple):
    """Cubes in the order of their keys, and sums of what lies in each."""

    key: NDArray[Any]  # (K,) int64
    table: NDArray[Any]  # (K, 8): points, their x, y, z; colored points, their red, green, blue
    most: NDArray[Any]  # (K,) points of the scan that has most of them
    scan: NDArray[Any]  # (K,) its number, the lowest of equals


class _Cubes:
    """The cubes of a grid about the first points, with the sums of what is added to them."""

    def __init__(self, edge: float) -> None:
        self._edge = edge
        self._anchor: NDArray[Any] | None = None
        self._sums = _Sums(np.empty(0, np.int64), np.empty((0, 8)), np.empty(0), np.empty(0, np.int32))
        self._pending: list[_Sums] = []
        self._pending_rows = 0

    def add(self, points: NDArray[Any], colors: NDArray[Any] | None, scan: int) -> None:
        """Add all points (N, 3) of one scan, and their colors (N, 3) if it has any."""
        if len(points) == 0:
            return
        if self._anchor is None:
            self._anchor = np.floor(np.median(points, axis=0) / self._edge) * self._edge
        local = points - self._anchor
        numbers = np.floor(local / self._edge)
        least = float(np.abs(local).max()) / _HALF
        expect(bool((np.abs(numbers + 0.5) < _HALF).all()), "spacing", f"at least {least:.3g} m", self._edge)
        x, y, z = (numbers.astype(np.int64) + _HALF).T
        table = np.zeros((len(points), 8))
        table[:, 0], table[:, 1:4] = 1.0, local
        if colors is not None:
            table[:, 4], table[:, 5:] = 1.0, colors
        key, begins, order = _grouped((x << 2 * _BITS) | (y << _BITS) | z)
        sums = np.add.reduceat(table[order], begins, axis=0)
        own = _Sums(key, sums, sums[:, 0].copy(), np.full(len(key), scan, np.int32))
        self._pending.append(own)
        self._pending_rows += len(key)
        if self._pending_rows >= max(len(self._sums.key) // 2, _MERGE_ROWS):
            self._merge()

    def take(self) -> _Selected:
        """The means of all cubes."""
        self._merge()
        table = self._sums.table
        points = table[:, 1:4] / table[:, :1] + (0.0 if self._anchor is None else self._anchor)
        painted = table[:, 4:5] > 0
        colors = np.where(painted, table[:, 5:] / np.maximum(table[:, 4:5], 1.0), _GRAY) if painted.any() else None
        return _Selected(points, colors, self._sums.scan)

    def _merge(self) -> None:
        parts = [self._sums, *self._pending]
        self._pending, self._pending_rows = [], 0
        every = _Sums(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        if len(every.key) == 0:
            return
        key, begins, order = _grouped(every.key, every.scan, -every.most)
        first = order[begins]  # of the scan with most points
        table = np.add.reduceat(every.table[order], begins, axis=0)
        self._sums = _Sums(key, table, every.most[first], every.scan[first])


def _grouped(key: NDArray[Any], *less: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Distinct keys in order, where the rows of each begin in an order of all rows, and that order.

    Rows of one key stand by the last of ``less`` first, then by those before it.
    """
    order = np.lexsort((*less, key)) if less else np.argsort(key, kind="stable")
    ordered = key[order]
    begins = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    return ordered[begins], begins, order
