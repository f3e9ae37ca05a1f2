"""Descriptors of the points of a packed batch."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.errors import expect, expect_shape
from torchreg.types.packing import checked_offsets


@checked_record
@dataclass(frozen=True, eq=False)
class Features:
    """One descriptor per point of a packed batch.

    Attributes:
        values: (P, D) floating point.
        offsets: (B+1,) int64, on the CPU, as in ``Clouds``.
        blocks: names and widths of the parts of a row, in order, such as (("fpfh", 33), ("pcfh", 11)).
        valid: (P,) bool; a false row describes nothing and is never matched.
    """

    values: Tensor
    offsets: Tensor
    blocks: tuple[tuple[str, int], ...]
    valid: Tensor

    def __post_init__(self) -> None:
        expect_shape(self.values, "values", ("P", "D"), "floating")
        rows, width = self.values.shape
        object.__setattr__(self, "offsets", checked_offsets(self.offsets, rows))
        expect(sum(size for _, size in self.blocks) == width, "blocks", f"widths that sum to {width}", self.blocks)
        expect_shape(self.valid, "valid", (rows,), torch.bool, self.values.device)

    def __len__(self) -> int:
        """The number of clouds, B."""
        return len(self.offsets) - 1

    def block(self, name: str) -> Tensor:
        """The columns (P, width) of one block, a view.

        Raises:
            ValueError: no block has this name.
        """
        begin = 0
        for block, size in self.blocks:
            if block == name:
                return self.values[:, begin : begin + size]
            begin += size
        raise ValueError(f"name: expected one of {[block for block, _ in self.blocks]}, got {name!r}")
