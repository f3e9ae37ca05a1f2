"""Points averaged in the cubes of a grid as they come, so that memory is for the cubes and not for the points.

A grid may double the edge of its cubes: eight cubes become one, whose sums are the sums of the eight.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_BITS = 21  # of the number of a cube along each axis
_HALF = 1 << (_BITS - 1)
_CUBES_ACROSS = 4096  # the middle 98 % of the points, along the longest axis, where no edge is given
_MERGE_ROWS = 1 << 19  # fewest sums that are put into order at once


class CloudRows(NamedTuple):
    """Some rows of a scan. All chunks of one scan have the same parts."""

    points: NDArray[Any]  # (n, 3) float64
    colors: NDArray[Any] | None = None  # (n, 3) as in the file
    normals: NDArray[Any] | None = None  # (n, 3) float64
    intensity: NDArray[Any] | None = None  # (n,)
    left_out: int = 0  # rows of the file that are no points, before or among these

    def where(self, rows: NDArray[Any] | slice) -> CloudRows:
        """The rows of a mask (n,) or a slice."""
        colors, normals, intensity = (None if part is None else part[rows] for part in self[1:4])
        return CloudRows(self.points[rows], colors, normals, intensity)


class VoxelGrid:
    """Keeps points with what belongs to them, or the means of cubes.

    Args:
        voxel: meters, edge of the cubes; ``None`` for none, or to choose it where ``at_most`` asks for cubes.
        at_most: how many points are kept as they are before cubes are taken, and how many cubes are left then.

    Attributes:
        edge: meters, of the cubes; ``None`` as long as all points are kept.
    """

    def __init__(self, voxel: float | None = None, at_most: int | None = None) -> None:
        self.edge: float | None = None
        self._voxel, self._at_most = voxel, at_most
        self._whole: list[CloudRows] = []
        self._rows = self._far = self._pending_rows = 0
        self._widths: tuple[int, ...] = ()
        self._anchor = np.zeros(3)
        self._keys, self._sums = np.empty(0, np.int64), np.empty((0, 0))
        self._pending: list[tuple[NDArray[Any], NDArray[Any]]] = []

    def add(self, rows: CloudRows) -> None:
        """Add rows whose points are finite."""
        if len(rows.points) == 0:
            return
        if self.edge is not None:
            self._sort_in(rows)
            return
        self._whole.append(rows)
        self._rows += len(rows.points)
        if self._rows > (self._at_most or 0) and not (self._voxel is None and self._at_most is None):
            self._begin()

    def take(self) -> CloudRows:
        """All that is kept, once everything was added."""
        if self.edge is None:
            whole, self._whole = self._whole or [CloudRows(np.empty((0, 3)))], []
            columns = list(zip(*whole, strict=True))[1:4]
            colors, normals, intensity = (None if column[0] is None else np.concatenate(column) for column in columns)
            return CloudRows(np.concatenate([rows.points for rows in whole]), colors, normals, intensity)
        self._merge()
        means = self._sums[:, 1:] / self._sums[:, :1]  # (K, W)
        ends = np.cumsum(self._widths)
        split = [means[:, end - width : end] if width else None for end, width in zip(ends, self._widths, strict=True)]
        colors, normals, intensity = split[1:]
        return CloudRows(self._anchor + means[:, :3], colors, normals, None if intensity is None else intensity[:, 0])

    def notes(self) -> tuple[str, ...]:
        """What a user should know."""
        if self.edge is None:
            return ()
        notes = [f"thinned while it was read: the mean of the points in each cube of {self.edge:.3g} m"]
        if self._far:
            notes.append(
                f"{self._far:,} points lie {_HALF * self.edge:.3g} m or more from the others and were left out"
            )
        return tuple(notes)

    def _begin(self) -> None:
        """Sort what was kept so far into cubes."""
        whole, self._whole = self._whole, []
        low, middle, high = np.percentile(np.concatenate([rows.points for rows in whole]), (1, 50, 99), axis=0)
        self.edge = self._voxel or max(float((high - low).max()) / _CUBES_ACROSS, 1e-9)
        self._anchor = np.floor(middle / self.edge) * self.edge
        for rows in whole:
            self._sort_in(rows)

    def _sort_in(self, rows: CloudRows) -> None:
        edge = self.edge or 1.0
        local = rows.points - self._anchor
        numbers = np.floor(local / edge)  # (n, 3)
        near = np.abs(numbers + 0.5).max(axis=1) < _HALF  # (n,)
        far = int((~near).sum())
        if far > 0:
            if self._at_most is None:
                least = float(np.abs(local).max()) / _HALF
                raise ValueError(f"voxel: expected at least {least:.3g} m for points that wide apart, got {edge:g}")
            self._far += far
            local, numbers, rows = local[near], numbers[near], rows.where(near)
        parts = (local, rows.colors, rows.normals, rows.intensity)
        columns = [None if part is None else part.reshape(len(local), -1) for part in parts]
        self._widths = tuple(0 if column is None else column.shape[1] for column in columns)
        there = [np.ones((len(local), 1)), *(column for column in columns if column is not None)]
        table = np.concatenate(there, axis=1, dtype=np.float64)  # (n, 1 + W)
        self._pending.append(_summed(_keys(numbers.astype(np.int64)), table))
        self._pending_rows += len(self._pending[-1][0])
        if self._pending_rows >= max(len(self._keys) // 2, _MERGE_ROWS):
            self._merge()

    def _merge(self) -> None:
        if self._pending:
            keys = np.concatenate([self._keys, *(keys for keys, _ in self._pending)])
            tables = [sums for _, sums in self._pending]
            table = np.concatenate([self._sums, *tables] if len(self._keys) else tables)
            self._pending, self._pending_rows = [], 0
            self._keys, self._sums = _summed(keys, table)
        while self._at_most is not None and len(self._keys) > self._at_most:
            self.edge = 2 * (self.edge or 1.0)
            self._keys, self._sums = _summed(_keys(_numbers(self._keys) >> 1), self._sums)


def _keys(numbers: NDArray[Any]) -> NDArray[Any]:
    """One number (n,) int64 for the three (n, 3) of a cube, each from -2^20 to 2^20 - 1."""
    x, y, z = (numbers + _HALF).T
    keys: NDArray[Any] = (x << 2 * _BITS) | (y << _BITS) | z
    return keys


def _numbers(keys: NDArray[Any]) -> NDArray[Any]:
    mask = (1 << _BITS) - 1
    return np.stack([keys >> 2 * _BITS, keys >> _BITS & mask, keys & mask], axis=1) - _HALF


def _summed(keys: NDArray[Any], table: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Distinct keys in order, and the sums of their rows, added in the order they came."""
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    begins = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return keys[begins], np.add.reduceat(table[order], begins, axis=0)
