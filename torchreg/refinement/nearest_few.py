"""The few nearest points of a target, by Open3D's tree on the CPU and by comparing all pairs elsewhere."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchreg.neighborhoods.distances import sum_of_squares
from torchreg.neighborhoods.open3d_search import Tree, uses_open3d

FEW = 4
"""Measured: with 4 the tree takes a third longer than with 2, and hardly a point is searched a second time."""

Search = Callable[[Tensor], Tensor]
"""From queries (Q, 3) to the rows of their nearest, (Q, min(FEW, N)), ascending by distance."""


def few_nearest(points: Tensor) -> Search:
    """The search in ``points`` (N, 3) float64, N > 0."""
    if uses_open3d("auto", points.device):
        tree = Tree(points)
        return lambda queries: tree.nearest(queries, FEW)
    return all_pairs(points)


def all_pairs(points: Tensor, max_bytes: int = 256 * 2**20) -> Search:
    """The search that compares every query with every point, in chunks of ``max_bytes``; lesser rows win ties."""
    rows = max(1, max_bytes // (4 * points.element_size() * len(points)))
    return lambda queries: torch.cat([_compare(chunk, points) for chunk in queries.split(rows)])


def _compare(queries: Tensor, points: Tensor) -> Tensor:
    square = sum_of_squares(*(a[:, None] - b for a, b in zip(queries.unbind(1), points.unbind(1), strict=True)))
    found = []
    for _ in range(min(FEW, len(points))):
        found.append(square.argmin(dim=1, keepdim=True))  # (Q, 1)
        square.scatter_(1, found[-1], torch.inf)
    return torch.cat(found, dim=1)
