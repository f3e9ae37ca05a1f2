"""Descriptors of the points of a packed batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.errors import expect, expect_shape
from torchreg.types.held import Held, Offsets, PerRow, held
from torchreg.types.packing import checked_offsets
from torchreg.types.record import PackedBatch
from torchreg.types.shown import counted, several, where


@checked_record
@dataclass(frozen=True, eq=False, repr=False)
class Features(PackedBatch):
    """One descriptor per point of a packed batch.

    Attributes:
        values: (P, D) floating point.
        offsets: (B+1,) int64, on the CPU, as in ``Clouds``.
        blocks: names and widths of the parts of a row, in order, such as (("fpfh", 33), ("pcfh", 11)).
        valid: (P,) bool; a false row describes nothing and is never matched.

    Example:
        >>> import torch, torchreg as tr
        >>> rows = tr.Features(torch.eye(3), torch.tensor([0, 3]), (("any", 3),), torch.tensor([True, True, False]))
        >>> rows.values.shape, rows.blocks
        (torch.Size([3, 3]), (('any', 3),))

        Of values (P, D) of a network of your own, all of them valid:

        >>> clouds, values = tr.Clouds(torch.rand(9, 3)), torch.rand(9, 16)
        >>> len(tr.Features(values, clouds.offsets, (("mine", 16),), torch.ones(9, dtype=torch.bool)))
        1
    """

    noun: ClassVar[str] = "clouds"

    values: Tensor = held(PerRow(casts=True))
    offsets: Tensor = held(Offsets())
    blocks: tuple[tuple[str, int], ...] = held(Held())
    valid: Tensor = held(PerRow())

    def __post_init__(self) -> None:
        expect_shape(self.values, "values", ("P", "D"), "floating")
        rows, width = self.values.shape
        object.__setattr__(self, "offsets", checked_offsets(self.offsets, rows))
        expect(sum(size for _, size in self.blocks) == width, "blocks", f"widths that sum to {width}", self.blocks)
        expect_shape(self.valid, "valid", (rows,), torch.bool, self.values.device)

    def __len__(self) -> int:
        """The number of clouds, B."""
        return len(self.offsets) - 1

    def _facts(self) -> Sequence[str]:
        sizes, invalid = counted(self.offsets.diff().tolist()), len(self.values) - int(self.valid.sum())
        return (
            f"{sizes} points of {several(len(self), 'clouds')}, {invalid:,} invalid",
            " + ".join(f"{name} {width}" for name, width in self.blocks) or "no block",
            where(self.values),
        )

    @staticmethod
    def _made_of(value: object) -> str:
        """How features are made of a tensor that came in their place, for messages."""
        if not isinstance(value, Tensor):
            return ""
        width = value.shape[1] if value.ndim == 2 else "D"
        return f'Features(values, clouds.offsets, (("mine", {width}),), valid) with valid (P,) bool'

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
