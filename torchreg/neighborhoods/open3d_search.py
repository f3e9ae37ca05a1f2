"""Hybrid search on the CPU through Open3D's k-d tree.

Two searches of Open3D find the same set. Its hybrid search collects and sorts all points within the radius,
its k-nearest search keeps the K nearest while it walks the tree. The former wins while few points lie within
the radius (measured, 10,000 points, K = 100, two threads: 28 within the radius 9 ms against 45 ms) and loses
without bound where many do (100,000 points all within the radius: 26 s against 0.5 s).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.morton import morton_order
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.neighborhoods.distances import mend_rows, squared_distances
from torchreg.neighborhoods.open3d_tree import Tree

SEARCH_SLOTS = 2**21  # slots asked of the tree at once: bounds the memory of its answer
CHUNK_SLOTS = 2**18  # slots worked on at once: they stay in the cache
SAMPLE = 128  # queries that estimate how many points lie within the radius
HYBRID_UP_TO = 1.25  # points within the radius, as a multiple of K, up to which the hybrid search is faster


def search_open3d(
    points: Tensor, spans: list[tuple[int, int]], limits: list[float], max_neighbors: int
) -> tuple[Tensor, Tensor, Tensor]:
    """The K nearest with d^2 < ``limits[b]`` among the points of the same cloud.

    Of points that tie for the last place the tree decides which stay.

    Args:
        points: (P, 3) float32 or float64 on the CPU.
        spans: the (begin, end) rows of the B clouds.
        limits: B squared radii in the precision of ``points``.
        max_neighbors: K.

    Returns:
        index (P, K) int64, valid (P, K) bool and sq_distance (P, K), as ``Neighborhoods`` holds them.
    """
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
        found = _find(tree, points, axes, part, limit, width)  # (part, width)
        for piece in row_chunks(found.shape[0], width, CHUNK_SLOTS):
            own = order[part][piece]  # (R,)
            near, squares = _measure(axes, torch.arange(part.start, part.stop)[piece], found[piece])
            near = order.index_select(0, near.view(-1)).view(near.shape)
            mend_rows(squares, near, limit)
            inside = squares < limit
            index[:, :width].index_copy_(0, own, near.where(inside, own[:, None]).add_(begin))
            valid[:, :width].index_copy_(0, own, inside)
            sq_distance[:, :width].index_copy_(0, own, squares.where(inside, 0))


def _measure(axes: Tensor, rows: Tensor, found: Tensor) -> tuple[Tensor, Tensor]:
    """The squared distance of what the tree found, infinite in empty slots, which then hold a legal row."""
    near = found.clamp_min(0)
    return near, squared_distances(axes, rows, near).masked_fill_(found < 0, torch.inf)


def _find(tree: Tree, points: Tensor, axes: Tensor, part: slice, limit: float, width: int) -> Tensor:
    """The nearest of the rows ``part`` by the faster search; int32, -1 where there are none."""
    sample = torch.arange(part.start, part.stop, max(1, (part.stop - part.start) // SAMPLE))
    _, squares = _measure(axes, sample, tree.nearest(points[sample], width))
    # A row that is full has more within the radius than it shows: as many as on a surface, by area.
    hidden = (limit / squares[:, -1]).clamp_min(1)
    within = (squares < limit).sum(dim=1) * hidden
    if within.mean() <= HYBRID_UP_TO * width:
        # A little wider, since Open3D squares and compares in its own way; the caller cuts exactly.
        return tree.nearest_within(points[part], limit**0.5 * (1 + 1e-5), width)
    return tree.nearest(points[part], width)
