"""The nearest point of another set: by ``nearest`` for one search, by ``PointIndex`` for many in the same points."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_device, expect_shape
from torchreg.geometry.morton import morton_order
from torchreg.neighborhoods.backends import backend_for
from torchreg.neighborhoods.distances import expect_searchable, sum_of_squares
from torchreg.neighborhoods.kd_tree import MOST, KdTree, fits_tree
from torchreg.neighborhoods.open3d_search import Tree

_TIES = 512  # points as near as the nearest that Open3D is asked for


class Nearest(NamedTuple):
    """One neighbor per query.

    Attributes:
        index: (Q,) int64, rows of the points searched; -1 where there are none.
        sq_distance: (Q,) squared meters; infinite where there are none.
    """

    index: Tensor  # type: ignore[assignment]  # takes the place of tuple.index
    sq_distance: Tensor


def nearest(query: Tensor, points: Tensor, *, backend: str = "auto", max_bytes: int = 256 * 2**20) -> Nearest:
    """Find the nearest of ``points`` for every point of ``query``, exactly.

    Of several that are equally near the one of smallest index is taken; ``"open3d"`` looks at some 500 of them at most.

    Args:
        query: (Q, 3) float32 or float64, meters.
        points: (N, 3) of the same dtype, on the same device and in the same frame.
        backend: as in ``neighbors``; the torch backend compares all pairs.
        max_bytes: bounds the working memory of the torch backend; the result does not depend on it.

    Returns:
        Nearest of (Q,). No gradient flows.

    Raises:
        ValueError: a shape, dtype or device other than stated, or coordinates that are not finite.

    Example:
        >>> points = torch.tensor([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
        >>> nearest(torch.tensor([[3.0, 0.0, 0.0]]), points)
        Nearest(index=tensor([1]), sq_distance=tensor([1.]))
    """
    expect_shape(query, "query", ("Q", 3))
    expect_shape(points, "points", ("N", 3))
    expect(query.dtype in (torch.float32, torch.float64), "query", "float32 or float64", query)
    expect(points.dtype == query.dtype, "points", f"the dtype of query, {query.dtype}", points)
    expect_device(points, "points", query.device)
    query, points = query.detach(), points.detach()
    expect_searchable(query, "query")
    expect_searchable(points, "points")
    used = backend_for(backend, points)
    if len(query) == 0 or len(points) == 0:
        return Nearest(
            torch.full((len(query),), -1, dtype=torch.int64, device=query.device),
            torch.full((len(query),), torch.inf, dtype=query.dtype, device=query.device),
        )
    if used == "native":
        return Nearest(*(column[:, 0] for column in KdTree(points).nearest(query)))
    index = _from_tree(query, points) if used == "open3d" else nearest_of_all(query, points, 1, max_bytes)[:, 0]
    return Nearest(index, sum_of_squares(*(query - points[index]).unbind(1)))


class PointIndex:
    """The nearest of fixed points (N, 3), by a tree built once on the CPU, by comparing all pairs elsewhere.

    Answers are those of ``nearest``.
    """

    def __init__(self, points: Tensor) -> None:
        self._points = points.detach()
        self._tree: KdTree | None = None
        self._foreign: Tree | None = None
        used = backend_for("auto", self._points) if len(points) > 0 else "torch"
        if used == "native":
            self._tree = KdTree(self._points)
        if used == "open3d":
            self._order = morton_order(self._points, torch.tensor([0, len(points)]))
            self._foreign = Tree(self._points[self._order].contiguous())

    def nearest(self, query: Tensor) -> Nearest:
        """The nearest point of every query (Q, 3); fastest where queries that follow each other lie close."""
        if self._tree is not None:
            return Nearest(*(column[:, 0] for column in self._tree.nearest(query)))
        if self._foreign is None or len(query) == 0:
            return nearest(query, self._points)
        index = _first_of(self._foreign, self._order, query.contiguous(), self._points)
        return Nearest(index, sum_of_squares(*(query - self._points[index]).unbind(1)))


def several_nearest(query: Tensor, points: Tensor, count: int, *, max_bytes: int = 256 * 2**20) -> Tensor:
    """The rows (Q, min(count, N)) int64 of the nearest of points (N, 3), N > 0, ascending by distance.

    Through a tree on the CPU, where both sides are best in Morton order; by comparing all pairs elsewhere.
    """
    if fits_tree(points) and count <= MOST:
        return KdTree(points).nearest(query, min(count, len(points)))[0]
    if query.device.type == "cpu":
        return Tree(points.contiguous()).nearest(query.contiguous(), count).long()
    return nearest_of_all(query, points, count, max_bytes)


def _from_tree(query: Tensor, points: Tensor) -> Tensor:
    """(Q,) int64 by Open3D's tree; both sides in Morton order, which is a third faster."""
    query_order = morton_order(query, torch.tensor([0, len(query)]))
    point_order = morton_order(points, torch.tensor([0, len(points)]))
    index = _first_of(Tree(points[point_order]), point_order, query[query_order], points)
    return torch.empty_like(query_order).index_copy_(0, query_order, index)


def _first_of(tree: Tree, order: Tensor, query: Tensor, points: Tensor) -> Tensor:
    """(Q,) int64: of the points nearest to each query the lowest row; the tree stands over ``points[order]``."""
    index, rows, width = query.new_empty(len(query), dtype=torch.int64), torch.arange(len(query)), 2
    while len(rows) > 0:
        width = min(width, len(points))
        asked = query.index_select(0, rows)
        near = order[tree.nearest(asked, width).long()]  # (R, K)
        square = sum_of_squares(*(q[:, None] - p[near] for q, p in zip(asked.unbind(1), points.unbind(1), strict=True)))
        least = square.amin(dim=1, keepdim=True)
        index[rows] = near.masked_fill(square > least, len(points)).amin(dim=1)
        # the tree rounds otherwise: what it puts last may be as near as the first
        open_ended = square[:, -1] <= least[:, 0] * (1 + 8 * torch.finfo(square.dtype).eps)
        rows = rows[open_ended] if width < min(len(points), _TIES) else rows[:0]
        width *= 4
    return index


def nearest_of_all(query: Tensor, points: Tensor, count: int, max_bytes: int) -> Tensor:
    """The nearest rows (Q, min(count, N)) int64 of points (N, 3), ascending by distance, ties to the lower row.

    Every query (Q, 3) is compared with every point, in chunks of ``max_bytes``.
    """
    chunk_rows = max(1, max_bytes // (4 * points.element_size() * len(points)))  # differences, and what argmin keeps
    chunks = []
    for chunk in query.split(chunk_rows):
        square = sum_of_squares(*(a[:, None] - b for a, b in zip(chunk.unbind(1), points.unbind(1), strict=True)))
        rows = [square.argmin(dim=1, keepdim=True)]  # (R, 1)
        while len(rows) < min(count, len(points)):
            square.scatter_(1, rows[-1], torch.inf)
            rows.append(square.argmin(dim=1, keepdim=True))
        chunks.append(torch.cat(rows, dim=1))
    return torch.cat(chunks)
