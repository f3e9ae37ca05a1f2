"""Hybrid search by all distances at once: slow for many points, but one graph of plain operations for any number.

It serves where a graph is captured (``torch.compile``, ``torch.export``), in which a tree cannot be walked.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.neighborhoods.distances import sum_of_squares


def search_dense(points: Tensor, limit: float, max_neighbors: int) -> tuple[Tensor, Tensor, Tensor]:
    """The neighborhoods of one cloud of at least ``max_neighbors`` points (P, 3).

    ``limit`` is the squared radius. Returns index (P, K) int64, valid (P, K) bool and squared distances (P, K), as
    ``Neighborhoods`` holds them; memory grows with P squared. Points at equal distances stand in the order of their
    rows, as in every search.
    """
    x, y, z = points.unbind(1)
    distance = sum_of_squares(*(axis[None, :] - axis[:, None] for axis in (x, y, z)))  # (P, P)
    # rows are in order already, and a stable sort leaves equals so
    square, index = (part[:, :max_neighbors] for part in distance.sort(dim=1, stable=True))
    valid = square < torch.full((), limit, dtype=points.dtype, device=points.device)
    own = torch.arange(points.shape[0], device=points.device)[:, None]
    return torch.where(valid, index, own), valid, torch.where(valid, square, 0)
