"""How far every pair of points is believed to be the same place."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torchreg.errors import expect, expect_device, expect_floating, expect_shape
from torchreg.types.packing import checked_offsets, spans


@dataclass(frozen=True, eq=False)
class SoftCorrespondences:
    """Soft matches of ``B`` pairs of clouds: one dense matrix each, since every point may match every other.

    Attributes:
        confidence: B matrices (N_b, M_b) floating point, not below 0: row i, column j says how far source point i and
            target point j of the pair are the same place. Rows and columns sum to 1 at most (a Sinkhorn that has
            not settled: nearly). Zero where a point is not described.
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
            object.__setattr__(self, name, checked_offsets(offsets, int(offsets[-1]), name))
        rows, columns = spans(self.source_offsets), spans(self.target_offsets)
        for matrix, (i, j), (k, m) in zip(self.confidence, rows, columns, strict=True):
            expect_shape(matrix, "confidence", (j - i, m - k))
            expect_floating(matrix, "confidence")
            expect(matrix.dtype == self.confidence[0].dtype, "confidence", "matrices of one dtype", matrix)
            expect_device(matrix, "confidence", self.confidence[0].device)

    def __len__(self) -> int:
        """The number of pairs, B."""
        return len(self.confidence)
