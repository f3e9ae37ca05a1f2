"""The search by a compiled tree, and the whole iteration of point-to-plane ICP in compiled code on such trees."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.neighborhoods.kd_tree import KdTree
from torchreg.refinement.found import FoundRows


class TreeSearch:
    """The nearest of points (N, 3) float64 that fit a tree."""

    def __init__(self, points: Tensor, count: int) -> None:
        self.tree = KdTree(points)
        self._count = min(count, len(points))

    def __call__(self, queries: Tensor) -> FoundRows:
        """The nearest, min(count, N) of them, ascending by (distance, row)."""
        return FoundRows.of_all(self.tree.nearest(queries, self._count)[0])

    @property
    def address(self) -> tuple[int, int, int, int]:
        """Where compiled code finds the tree: planes, order, boxes, and the number of points."""
        tree = self.tree
        return tree.planes.data_ptr(), tree.order.data_ptr(), tree.boxes.data_ptr(), len(tree.order)


def addresses(searches: Sequence[object]) -> Tensor | None:
    """The addresses (B, 4) of the trees of B searches; ``None`` where any has none."""
    trees = [search.address for search in searches if isinstance(search, TreeSearch)]
    return torch.tensor(trees, dtype=torch.int64) if len(trees) == len(searches) else None
