"""The nearest points in more than three dimensions: by the tree over three of them.

Points are no nearer in all dimensions than in x, y, z. So the nearest in space are looked at first: once the last of
them is farther in space than the best are in all dimensions, no other point can be nearer. Where that does not come
true among the 64 nearest, a query is compared with all points.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchreg.geometry.numerics.gather import gather_columns
from torchreg.neighborhoods.distances import sort_rows
from torchreg.neighborhoods.kd_tree import MOST, KdTree, fits_tree
from torchreg.neighborhoods.open3d_search import Tree

_FIRST = 16  # nearest in space that are looked at first
_ROUNDING = 1e-12  # relative, on squared distances
_MAX_BYTES = 64 << 20

NearestInSpace = Callable[[Tensor, int], Tensor]
"""From queries (Q, 3) and a count to the rows (Q, count) of their nearest in space, ascending by distance."""


class MetricSearch:
    """The ``count`` nearest of points (N, S) float64, N > 0 and S > 3, by the sum of all squared differences.

    Args:
        points: x, y, z first, then coordinates in meters.
        count: how many are found, at most N.
    """

    def __init__(self, points: Tensor, count: int) -> None:
        self._axes = points.t().contiguous()  # (S, N)
        self._count = min(count, len(points))
        self._in_space = _nearest_in_space(points[:, :3].contiguous())

    def __call__(self, queries: Tensor) -> Tensor:
        """The rows (Q, count) of the nearest, ascending by (distance, row)."""
        if self._in_space is None:
            return self._among_all(queries)
        out = torch.empty(len(queries), self._count, dtype=torch.int64)
        rows, width, total = torch.arange(len(queries)), _FIRST, self._axes.shape[1]
        while len(rows) > 0 and width <= MOST:
            asked, width = queries[rows], min(width, total)
            near = self._in_space(asked[:, :3].contiguous(), width)  # (R, K)
            best, index = self._ranked(asked, near)
            out[rows] = index
            farthest = gather_columns(self._axes[:3], near[:, -1]) - asked[:, :3].t()
            bound = _sum_of_squares(farthest) * (1 - _ROUNDING)
            rows = rows[(bound <= best[:, -1]) & (width < total)]
            width *= 2
        out[rows] = self._among_all(queries[rows])
        return out

    def _among_all(self, queries: Tensor) -> Tensor:
        """The rows (Q, count) of the nearest, every query being compared with every point."""
        total = self._axes.shape[1]
        every = torch.arange(total, device=queries.device)
        parts = queries.split(max(1, _MAX_BYTES // (8 * len(self._axes) * total)))
        return torch.cat([self._ranked(part, every.expand(len(part), total))[1] for part in parts])

    def _ranked(self, queries: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Of the rows (R, K) the nearest of every query: squared distances and rows (R, count)."""
        square = _sum_of_squares(gather_columns(self._axes, rows) - queries.t()[:, :, None])
        if rows.shape[1] > MOST:  # all points: find the few before they are ordered, equal ones included
            last = square.topk(self._count, dim=1, largest=False).values[:, -1:]
            first = torch.where(square < last, -1, torch.where(square == last, rows, rows.shape[1]))
            chosen = first.topk(self._count, dim=1, largest=False).indices
            square, rows = square.gather(1, chosen), rows.gather(1, chosen)
        square, rows = sort_rows(square, rows)
        return square[:, : self._count], rows[:, : self._count]


def _nearest_in_space(points: Tensor) -> NearestInSpace | None:
    """The search in points (N, 3); ``None`` where there is no tree, as on other devices."""
    if fits_tree(points):
        compiled = KdTree(points)
        return lambda queries, count: compiled.nearest(queries, count)[0]
    if points.device.type != "cpu":
        return None
    tree = Tree(points)
    return lambda queries, count: tree.nearest(queries, count).long()


def _sum_of_squares(differences: Tensor) -> Tensor:
    """Of (S, ...), one after another."""
    total = differences[0] * differences[0]
    for each in differences[1:].unbind(0):
        total = total + each * each
    return total
