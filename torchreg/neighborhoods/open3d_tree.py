"""Open3D's k-d tree (``core.nns``: nanoflann, compiled and threaded) behind torch tensors, without copies."""

from __future__ import annotations

from typing import Any

from torch import Tensor
from torch.utils.dlpack import from_dlpack

from torchreg.open3d_loader import load_open3d


class Tree:
    """A k-d tree over points (N, 3) in float32 or float64 on the CPU, N > 0.

    It keeps the points' memory alive and must not see it changed. Its answers are int32 (measured: 10 to
    18 % faster than int64).
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
