"""The edge test on many samples: of every edge by itself, or looked up where a pair has few correspondences.

There are as many edges among 180 correspondences as in 10,000 samples, and a run draws 600,000. So once the samples
drawn are many enough, the marks of all edges are made at once, and a sample costs three reads from a table that
stays in the cache. The first edge drops most samples, so edges are tested one by one on what is left.
"""

from __future__ import annotations

from itertools import combinations

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.solvers.ransac.prune import FITTING, edge_marks, fitting_slack

_TABLE_EDGES = 1 << 23  # bytes of a table at most
_EDGES_PER_SAMPLE = 16  # an entry of the table costs so much less than the edges of a sample: measured on two cores


class Edges:
    """The edges among the correspondences (3, M) twice of a pair."""

    def __init__(self, source: Tensor, target: Tensor, similarity: float, threshold: float) -> None:
        self._source, self._target, self._similarity = source, target, similarity
        self._slack = fitting_slack(source, target, threshold)
        self._tested = 0
        self._table: Tensor | None = None

    def sift(self, samples: Tensor) -> tuple[int, Tensor]:
        """Of samples (R, S): how many have similar edges only, and those (K, S) whose edges all fit, in order."""
        self._tested += len(samples)
        if self._table is None and self._source.shape[1] ** 2 <= min(_TABLE_EDGES, _EDGES_PER_SAMPLE * self._tested):
            self._table = self._marks_of_all()
        lowest = torch.full((len(samples),), FITTING, dtype=torch.uint8, device=samples.device)
        for a, b in combinations(range(samples.shape[1]), 2):
            lowest = torch.minimum(lowest, self._marks(samples[:, a], samples[:, b]))
            left = lowest.nonzero()[:, 0]
            samples, lowest = samples.index_select(0, left), lowest.index_select(0, left)
        return len(samples), samples.index_select(0, (lowest == FITTING).nonzero()[:, 0])

    def _marks(self, one: Tensor, other: Tensor) -> Tensor:
        """Of the edges from correspondences (R,) to others (R,)."""
        if self._table is not None:
            return self._table.index_select(0, torch.add(other, one, alpha=self._source.shape[1]))
        source, target = (
            side.index_select(1, one) - side.index_select(1, other) for side in (self._source, self._target)
        )
        return edge_marks(source, target, self._similarity, self._slack)

    def _marks_of_all(self) -> Tensor:
        """(M * M,) uint8."""
        count = self._source.shape[1]
        parts = [
            edge_marks(
                self._source[:, rows, None] - self._source[:, None],
                self._target[:, rows, None] - self._target[:, None],
                self._similarity,
                self._slack,
            )
            for rows in row_chunks(count, 3 * count)
        ]
        return torch.cat(parts).flatten()
