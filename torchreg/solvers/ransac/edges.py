"""Samples that cannot be right by the lengths of their edges, dropped before any solve.

A rigid motion keeps lengths. So a sample is dropped when an edge of its polygon in one cloud is shorter than
``edge_similarity`` times the same edge in the other (as Open3D's CorrespondenceCheckerBasedOnEdgeLength; the
paper: 0.9), or when it has no length: a point twice. And a transform that brings both ends of an edge within a
threshold of their partners changes its length by no more than twice the threshold; an edge that changes more cannot
fit.

There are as many edges among 180 correspondences as in 10,000 samples, and a run draws 600,000. So once enough samples
are drawn, the marks of all edges are computed at once, and a sample costs three reads from a table that stays in the
cache. The first edge drops most samples, so edges are tested one by one on the samples left.
"""

from __future__ import annotations

from itertools import combinations

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks

_TABLE_EDGES = 1 << 23  # bytes of a table at most
_EDGES_PER_SAMPLE = 16  # an entry of the table costs so much less than the edges of a sample: measured on two cores
_ROUNDINGS = 1024  # far above the rounding of a length, of a solve and of a residual, in units of the coordinates
_WIDER = 1.02  # likewise, of the threshold

DISSIMILAR, SIMILAR, FITTING = 0, 1, 2
"""Marks of an edge; a fitting one is also similar."""


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


def edge_marks(source: Tensor, target: Tensor, similarity: float, slack: float) -> Tensor:
    """Judge edges (3, ...) by their lengths in both clouds: (...) uint8, ``DISSIMILAR``, ``SIMILAR`` or ``FITTING``.

    The shorter of two similar edges has ``similarity`` of the length of the other at least; fitting ones differ by
    ``slack`` meters at most.
    """
    limit = similarity * similarity
    a, b = _square(source), _square(target)
    similar = (a >= limit * b) & (b >= limit * a) & (a > 0) & (b > 0)
    apart = a.sqrt_().sub_(b.sqrt_()).abs_() > slack
    return similar.to(torch.uint8).mul_(FITTING - apart.to(torch.uint8))


def fitting_slack(source: Tensor, target: Tensor, threshold: float) -> float:
    """By how much lengths among points (3, M) and among their partners differ where both ends of an edge fit."""
    reach = float(torch.maximum(source.abs().amax(), target.abs().amax()))
    return 2 * _WIDER * threshold + _ROUNDINGS * reach * torch.finfo(source.dtype).eps


def _square(vectors: Tensor) -> Tensor:
    x, y, z = vectors.unbind(0)
    return x * x + y * y + z * z
