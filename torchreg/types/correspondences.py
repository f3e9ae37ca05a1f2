"""Putative matches between points of two clouds."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.errors import expect_device, expect_dtype, expect_floating, expect_shape
from torchreg.types.packing import checked_offsets


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
        expect_shape(self.source, "source", ("M",))
        expect_dtype(self.source, "source", torch.int64)
        count, device = self.source.shape[0], self.source.device
        expect_shape(self.target, "target", (count,))
        expect_dtype(self.target, "target", torch.int64)
        expect_shape(self.score, "score", (count,))
        expect_floating(self.score, "score")
        expect_device(self.target, "target", device)
        expect_device(self.score, "score", device)
        object.__setattr__(self, "offsets", checked_offsets(self.offsets, count))

    def __len__(self) -> int:
        """The number of pairs, B."""
        return len(self.offsets) - 1
