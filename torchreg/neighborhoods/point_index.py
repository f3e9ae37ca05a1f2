"""A point set that is asked for nearest neighbors many times."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.morton import morton_order
from torchreg.neighborhoods.backends import uses_open3d
from torchreg.neighborhoods.distances import sum_of_squares
from torchreg.neighborhoods.nearest import Nearest, nearest
from torchreg.neighborhoods.open3d_tree import Tree


class PointIndex:
    """The nearest of fixed points (N, 3), by a tree built once on the CPU, by comparing all pairs elsewhere.

    Answers are those of ``nearest``.
    """

    def __init__(self, points: Tensor) -> None:
        self._points = points.detach()
        self._tree: Tree | None = None
        if len(points) > 0 and uses_open3d("auto", points.device):
            self._order = morton_order(self._points, torch.tensor([0, len(points)]))
            self._tree = Tree(self._points[self._order].contiguous())

    def nearest(self, query: Tensor) -> Nearest:
        """The nearest point of every query (Q, 3); fastest where queries that follow each other lie close."""
        if self._tree is None or len(query) == 0:
            return nearest(query, self._points)
        index = self._order.index_select(0, self._tree.nearest(query.contiguous(), 1)[:, 0].long())
        return Nearest(index, sum_of_squares(*(query - self._points[index]).unbind(1)))
