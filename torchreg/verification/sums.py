"""Sums of rows that are filled up with zeros, with the bits of ``stable_sum``.

``stable_sum`` adds in blocks of 1,024. Zeros at the end of a block change nothing, and neither do blocks of zeros. So
rows of different lengths may stand beside each other, and short ones need no whole block: multiples of 64 are added
in the same order, whatever the width of the processor's vectors (of 2 to 8 numbers, four at once).
"""

from __future__ import annotations

from torch import Tensor

_BLOCK = 1024
_STEP = 64


def padded(count: int) -> int:
    """The length to which rows of at most ``count`` numbers are filled up."""
    step = _STEP if count <= _BLOCK else _BLOCK
    return max(1, -(-count // step)) * step


def row_sums(values: Tensor) -> Tensor:
    """Sums (...) of rows (..., L), where L is ``padded`` of something."""
    values = values.contiguous()  # across the memory, rows would be added in another order
    if values.shape[-1] <= _BLOCK:
        return values.sum(dim=-1)
    blocks = values.view(*values.shape[:-1], -1, _BLOCK).sum(dim=-1)  # (..., blocks)
    return blocks.cumsum(dim=-1)[..., -1]
