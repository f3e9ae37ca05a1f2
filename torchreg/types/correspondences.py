"""Pairs of points that may be the same place: listed one by one, or as a confidence for every pair."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.errors import expect, expect_shape
from torchreg.types.packing import checked_offsets, spans


@checked_record
@dataclass(frozen=True, eq=False)
class Correspondences:
    """Putative matches of ``B`` pairs of clouds, packed.

    Attributes:
        source: (M,) int64, global rows of the source batch.
        target: (M,) int64, global rows of the target batch.
        offsets: (B+1,) int64, on the CPU; pair ``b`` holds the matches ``offsets[b]:offsets[b+1]``.
        score: (M,) floating point; the matcher's distance in feature space: the smaller, the better.
    """

    source: Tensor
    target: Tensor
    offsets: Tensor
    score: Tensor

    def __post_init__(self) -> None:
        expect_shape(self.source, "source", ("M",), torch.int64)
        count, device = self.source.shape[0], self.source.device
        expect_shape(self.target, "target", (count,), torch.int64, device)
        expect_shape(self.score, "score", (count,), "floating", device)
        object.__setattr__(self, "offsets", checked_offsets(self.offsets, count))

    def __len__(self) -> int:
        """The number of pairs, B."""
        return len(self.offsets) - 1


@checked_record
@dataclass(frozen=True, eq=False)
class SoftCorrespondences:
    """Soft matches of ``B`` pairs of clouds: one dense matrix each, since every point may match every other.

    Attributes:
        confidence: B matrices (N_b, M_b) floating point, not below 0: row i, column j is the confidence that source
            point i and target point j of the pair are the same place. Rows and columns sum to 1 at most (nearly, where
            Sinkhorn has not converged). Zero where a point has no valid descriptor.
        source_offsets: (B+1,) int64, on the CPU, of the packed source clouds; N_b = their differences.
        target_offsets: (B+1,) int64, likewise of the target clouds.
    """

    confidence: tuple[Tensor, ...]
    source_offsets: Tensor
    target_offsets: Tensor

    def __post_init__(self) -> None:
        pairs = len(self.confidence)
        for name in ("source_offsets", "target_offsets"):
            offsets = getattr(self, name)
            expect_shape(offsets, name, (pairs + 1,))
            if torch.compiler.is_compiling():  # where values are not known
                return
            object.__setattr__(self, name, checked_offsets(offsets, int(offsets[-1]), name))
        rows, columns = spans(self.source_offsets), spans(self.target_offsets)
        for matrix, (i, j), (k, m) in zip(self.confidence, rows, columns, strict=True):
            expect_shape(matrix, "confidence", (j - i, m - k), "floating", self.confidence[0].device)
            expect(matrix.dtype == self.confidence[0].dtype, "confidence", "matrices of one dtype", matrix)

    def __len__(self) -> int:
        """The number of pairs, B."""
        return len(self.confidence)
