"""A k-d tree by compiled kernels: neighborhoods of clouds, and the nearest points of another set; on the CPU.

Its answers are those of the functions in torch to the last index: of equally near points the lower row comes first.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.native import KERNEL_TYPES, call, native
from torchreg.types.packing import offsets_of

MOST = 64
"""Points that ``KdTree.nearest`` finds at most for one query."""

_LARGEST = 2**31 - 1  # rows are int32 within a tree


def fits_tree(points: Tensor) -> bool:
    """Whether a tree can stand over these points (N, 3)."""
    return len(points) > 0 and len(points) <= _LARGEST and points.dtype in KERNEL_TYPES and native(points)


def search_tree(
    points: Tensor, spans: list[tuple[int, int]], limits: list[float], max_neighbors: int
) -> tuple[Tensor, Tensor, Tensor]:
    """As ``search_cells``, with its results; points that ``fits_tree``."""
    rows = len(points)
    index = torch.empty(rows, max_neighbors, dtype=torch.int64)
    valid = torch.empty(rows, max_neighbors, dtype=torch.bool)
    sq_distance = torch.empty(rows, max_neighbors, dtype=points.dtype)
    offsets = offsets_of([end - begin for begin, end in spans])
    squares = torch.tensor(limits, dtype=torch.float64).to(points.dtype)
    name = f"search_clouds_{KERNEL_TYPES[points.dtype]}"
    call(name, points.contiguous(), offsets, squares, len(spans), max_neighbors, index, valid, sq_distance)
    return index, valid, sq_distance


class KdTree:
    """A tree over points (N, 3) that ``fits_tree``; it keeps a copy of them in its own order.

    Attributes:
        planes: (3, N), coordinates in the order of the tree.
        order: (N,) int32, the row of every one of them.
        boxes: (M, 6), what the tree is made of.
    """

    def __init__(self, points: Tensor) -> None:
        count = len(points)
        self._dtype = KERNEL_TYPES[points.dtype]
        self.planes = torch.empty(3, count, dtype=points.dtype)
        self.order = torch.empty(count, dtype=torch.int32)
        self.boxes = torch.empty(call("tree_boxes", count), 6, dtype=points.dtype)
        points = points.contiguous()
        call(f"build_tree_{self._dtype}", points, count, self.planes, self.order, self.boxes)

    def nearest(self, query: Tensor, count: int = 1, limit: float = math.inf) -> tuple[Tensor, Tensor]:
        """The nearest of every query (Q, 3) with d^2 < ``limit``, ascending by (d^2, row), at most ``MOST``.

        Returns rows (Q, count) int64, -1 where there are none, and squared distances (Q, count), infinite there.
        """
        rows = torch.empty(len(query), count, dtype=torch.int64)
        squares = torch.empty(len(query), count, dtype=query.dtype)
        tree = (self.planes, self.order, self.boxes, len(self.order))
        call(
            f"nearest_in_tree_{self._dtype}", *tree, query.contiguous(), len(query), count, float(limit), rows, squares
        )
        return rows, squares
