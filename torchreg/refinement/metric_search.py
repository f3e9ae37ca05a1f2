"""The nearest points in more than three dimensions: by the tree over three of them.

Points are no nearer in all dimensions than in x, y, z. So the nearest in space are looked at first: once the last of
them is farther in space than the best are in all dimensions, no other point can be nearer, and once it is farther than
the limit, no other point matters. Where neither comes true among the 64 nearest, the points are looked at in blocks of
such as lie together: a block counts where its box, in all dimensions, is as near as the best or the limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.morton import morton_order
from torchreg.geometry.numerics.gather import gather_columns
from torchreg.neighborhoods.distances import sort_rows
from torchreg.neighborhoods.kd_tree import MOST, KdTree, fits_tree
from torchreg.neighborhoods.open3d_search import Tree
from torchreg.refinement.found import FoundRows
from torchreg.types.packing import offsets_of

_FIRST = 16  # nearest in space that are looked at first
_BLOCK = 64  # points that are looked at together
_ROUNDING = 1e-12  # relative, on squared distances
_MAX_BYTES = 64 << 20

NearestInSpace = Callable[[Tensor, int], Tensor]
"""From queries (Q, 3) and a count to the rows (Q, count) of their nearest in space, ascending by distance."""


class _Boxes(NamedTuple):
    """The points in blocks, n in all, and the boxes around them."""

    members: Tensor  # (n, _BLOCK) rows; the last block is filled with the row behind the last
    low: Tensor  # (S, n)
    high: Tensor  # (S, n)


class MetricSearch:
    """The ``count`` nearest of points (N, S) float64, N > 0 and S > 3, by the sum of all squared differences.

    Args:
        points: x, y, z first, then coordinates in meters.
        count: how many are found, at most N.
        limit: meters. Points nearer than this are found as in a full search; where there are fewer than ``count``,
            the rest may be any others.
    """

    def __init__(self, points: Tensor, count: int, limit: float = math.inf) -> None:
        nowhere = points.new_full((1, points.shape[1]), math.inf)  # fills a block
        self._axes = torch.cat([points, nowhere]).t().contiguous()  # (S, N + 1)
        self._total, self._limit = len(points), limit * limit
        self._count = min(count, len(points))
        self._in_space = _nearest_in_space(points[:, :3].contiguous())

    def __call__(self, queries: Tensor) -> FoundRows:
        """The nearest, ascending by (distance, row)."""
        if self._in_space is None:
            return FoundRows.of_all(self._among_all(queries))
        out = torch.empty(len(queries), self._count, dtype=torch.int64)
        last, beyond = queries.new_empty(len(queries)), queries.new_full((len(queries),), math.inf)  # squared
        rows, width = torch.arange(len(queries)), _FIRST
        while len(rows) > 0 and width <= MOST:
            asked, width = queries[rows], min(width, self._total)
            near = self._in_space(asked[:, :3].contiguous(), width)  # (R, K)
            best, index = self._ranked(asked, near)
            out[rows], last[rows] = index, best[:, -1]
            if width == self._total:
                beyond[rows] = math.inf
                return FoundRows(out, beyond.sqrt())
            farthest = gather_columns(self._axes[:3], near[:, -1]) - asked[:, :3].t()
            bound = _sum_of_squares(farthest) * (1 - _ROUNDING)
            beyond[rows] = bound
            rows = rows[bound <= best[:, -1].clamp(max=self._limit)]
            width *= 2
        for part in rows.split(max(1, _MAX_BYTES // (8 * len(self._axes) * self._total // _BLOCK + 1))):
            self._in_boxes(queries[part], last[part].clamp(max=self._limit), part, out, beyond)
        return FoundRows(out, beyond.sqrt())

    def _in_boxes(self, queries: Tensor, reach: Tensor, rows: Tensor, out: Tensor, beyond: Tensor) -> None:
        """Compare queries (R, S) with the points of all boxes within ``reach`` (R,), squared; write their rows (R,)."""
        boxes = self._boxes
        every = len(boxes.members)
        axes = zip(queries.t()[:, :, None], boxes.low[:, None], boxes.high[:, None], strict=True)
        # no farther than any of its points as differences are rounded, since all is summed in the same order
        apart = _sum_of_squares([torch.maximum(low - q, q - high).clamp_(min=0) for q, low, high in axes])  # (R, n)
        within = (apart <= reach[:, None]).sum(dim=1)
        width, narrower = 2, 0
        while narrower < every:  # queries of about as many boxes together
            width = min(width, every)
            mine = ((within > narrower) | (narrower == 0)) & (within <= width)
            for part in mine.nonzero()[:, 0].split(max(1, _MAX_BYTES // (8 * len(self._axes) * _BLOCK * width))):
                gap, nearest = apart[part].topk(min(width + 1, every), dim=1, largest=False)
                members = boxes.members[nearest[:, :width]].flatten(1)
                out[rows[part]] = self._ranked(queries[part], members)[1]
                beyond[rows[part]] = gap[:, -1] if width < every else math.inf
            narrower, width = width, 2 * width

    def _among_all(self, queries: Tensor) -> Tensor:
        """The rows (Q, count) of the nearest, every query being compared with every point."""
        every = torch.arange(self._total, device=queries.device)
        parts = queries.split(max(1, _MAX_BYTES // (8 * len(self._axes) * self._total)))
        return torch.cat([self._ranked(part, every.expand(len(part), self._total))[1] for part in parts])

    def _ranked(self, queries: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Of the rows (R, K) the nearest of every query: squared distances and rows (R, count)."""
        square = _sum_of_squares(gather_columns(self._axes, rows) - queries.t()[:, :, None])
        if rows.shape[1] > MOST:  # many: find the few before they are ordered, equal ones included
            last = square.topk(self._count, dim=1, largest=False).values[:, -1:]
            first = torch.where(square < last, -1, torch.where(square == last, rows, self._total))
            chosen = first.topk(self._count, dim=1, largest=False).indices
            square, rows = square.gather(1, chosen), rows.gather(1, chosen)
        square, rows = sort_rows(square, rows)
        return square[:, : self._count], rows[:, : self._count]

    @cached_property
    def _boxes(self) -> _Boxes:
        points = self._axes[:, :-1]
        order = morton_order(points[:3].t().contiguous(), offsets_of([self._total]))
        filled = order.new_full((-len(order) % _BLOCK,), self._total)
        members = torch.cat([order, filled]).view(-1, _BLOCK)
        inside = points[:, members.clamp(max=self._total - 1)]  # (S, n, _BLOCK)
        real = members < self._total
        low = inside.masked_fill(~real, math.inf).amin(dim=2)
        return _Boxes(members, low, inside.masked_fill(~real, -math.inf).amax(dim=2))


def _nearest_in_space(points: Tensor) -> NearestInSpace | None:
    """The search in points (N, 3); ``None`` where there is no tree, as on other devices."""
    if fits_tree(points):
        compiled = KdTree(points)
        return lambda queries, count: compiled.nearest(queries, count)[0]
    if points.device.type != "cpu":
        return None
    tree = Tree(points)
    return lambda queries, count: tree.nearest(queries, count).long()


def _sum_of_squares(differences: Tensor | list[Tensor]) -> Tensor:
    """Of (S, ...), one after another."""
    first, *others = differences
    total = first * first
    for each in others:
        total = total + each * each
    return total
