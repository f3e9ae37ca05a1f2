"""Hybrid search on the CPU through Open3D's k-d tree.

Two searches of Open3D find the same set. Its hybrid search collects and sorts all points within the radius,
its k-nearest search keeps the K nearest while it walks the tree. The former wins while few points lie within
the radius (measured, 10,000 points, K = 100, two threads: 28 within the radius 9 ms against 45 ms) and loses
without bound where many do (100,000 points all within the radius: 26 s against 0.5 s).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.utils.dlpack import from_dlpack

from torchreg.geometry.morton import morton_order
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.neighborhoods.distances import sort_rows, squared_distances
from torchreg.open3d_loader import load_open3d

SEARCH_SLOTS = 2**21  # slots asked of the tree at once: bounds the memory of its answer
CHUNK_SLOTS = 2**18  # slots worked on at once: they stay in the cache
SAMPLE = 128  # queries that estimate how many points lie within the radius
HYBRID_UP_TO = 1.25  # points within the radius, as a multiple of K, up to which the hybrid search is faster


def search_open3d(
    points: Tensor, spans: list[tuple[int, int]], limits: list[float], max_neighbors: int
) -> tuple[Tensor, Tensor, Tensor]:
    """As ``search_cells``, on the CPU; of points that tie for the last place the tree decides which stay."""
    rows = points.shape[0]
    index = torch.empty(rows, max_neighbors, dtype=torch.int64)
    valid = torch.empty(rows, max_neighbors, dtype=torch.bool)
    sq_distance = torch.empty(rows, max_neighbors, dtype=points.dtype)
    for (begin, end), limit in zip(spans, limits, strict=True):
        if end > begin:
            part = slice(begin, end)
            _search_cloud(points[part], begin, limit, index[part], valid[part], sq_distance[part])
    return index, valid, sq_distance


def _search_cloud(points: Tensor, begin: int, limit: float, index: Tensor, valid: Tensor, sq_distance: Tensor) -> None:
    """Fill the rows of one cloud (views of the outputs), whose first row is ``begin``."""
    rows = points.shape[0]
    order = morton_order(points, torch.tensor([0, rows]))
    points = points[order]  # (N, 3): the tree answers up to a third faster in this order
    axes = points.t().contiguous()  # (3, N)
    tree = Tree(points)
    width = min(index.shape[1], rows)
    index[:, width:] = torch.arange(begin, begin + rows)[:, None]
    valid[:, width:] = False
    sq_distance[:, width:] = 0
    for part in row_chunks(rows, width, SEARCH_SLOTS):
        answers = _ask(tree, points, axes, part, limit, width)  # (part, width)
        for piece in row_chunks(answers.shape[0], width, CHUNK_SLOTS):
            query = order[part][piece]  # (R,)
            near, squares = _measure(axes, torch.arange(part.start, part.stop)[piece], answers[piece])
            near = order.index_select(0, near.view(-1)).view(near.shape)
            mend_rows(squares, near, limit)
            inside = squares < limit
            index[:, :width].index_copy_(0, query, near.where(inside, query[:, None]).add_(begin))
            valid[:, :width].index_copy_(0, query, inside)
            sq_distance[:, :width].index_copy_(0, query, squares.where(inside, 0))


def _measure(axes: Tensor, rows: Tensor, answers: Tensor) -> tuple[Tensor, Tensor]:
    """The tree's answers with a legal row in empty slots, and their squared distances, infinite in empty slots."""
    near = answers.clamp_min(0)
    return near, squared_distances(axes, rows, near).masked_fill_(answers < 0, torch.inf)


def _ask(tree: Tree, points: Tensor, axes: Tensor, part: slice, limit: float, width: int) -> Tensor:
    """The nearest of the rows ``part`` by the faster search; int32, -1 where there are none."""
    sample = torch.arange(part.start, part.stop, max(1, (part.stop - part.start) // SAMPLE))
    _, squares = _measure(axes, sample, tree.nearest(points[sample], width))
    # A full row hides points within the radius; their number is estimated as on a surface, by area.
    hidden = (limit / squares[:, -1]).clamp_min(1)
    within = (squares < limit).sum(dim=1) * hidden
    if within.mean() <= HYBRID_UP_TO * width:
        # A little wider, since Open3D squares and compares with other roundings; the caller cuts exactly.
        return tree.nearest_within(points[part], limit**0.5 * (1 + 1e-5), width)
    return tree.nearest(points[part], width)


def mend_rows(sq_distance: Tensor, index: Tensor, limit: float) -> None:
    """Put the rows of a compiled search that are not in order yet in order, in place; on the CPU.

    Such a search returns its rows ascending by distance, but it leaves ties in any order. So only a few
    rows need sorting. Slots of ``limit`` and above are invalid and may come in any order.
    """
    later = sq_distance[:, 1:]
    unordered = (later <= sq_distance[:, :-1]) & (later < limit)
    rows = unordered.any(dim=1).nonzero().squeeze(1)
    if len(rows) > 0:
        sq_distance[rows], index[rows] = sort_rows(sq_distance[rows], index[rows])


class Tree:
    """A k-d tree over points (N, 3) in float32 or float64 on the CPU, N > 0.

    It is Open3D's ``core.nns`` (nanoflann, compiled and threaded) behind torch tensors, without copies: the points
    must not change while it lives. Its answers are int32 (measured: 10 to 18 % faster than int64).
    """

    def __init__(self, points: Tensor) -> None:
        core = load_open3d().core
        self._core = core
        self._search = core.nns.NearestNeighborSearch(self._give(points), core.int32)
        self._search.knn_index()

    def nearest(self, queries: Tensor, count: int) -> Tensor:
        """The ``count`` nearest of every query, ascending by distance: (Q, min(count, N)) int32."""
        return _take(self._search.knn_search(self._give(queries), count)[0])

    def nearest_within(self, queries: Tensor, radius: float, count: int) -> Tensor:
        """As ``nearest``, only those within ``radius``: (Q, count) int32, -1 in the slots that stay empty."""
        return _take(self._search.hybrid_search(self._give(queries), radius, count)[0])

    def _give(self, tensor: Tensor) -> Any:  # noqa: ANN401
        return self._core.Tensor.from_dlpack(tensor.contiguous().__dlpack__())


def _take(tensor: Any) -> Tensor:  # noqa: ANN401
    taken: Tensor = from_dlpack(tensor.to_dlpack())
    return taken
