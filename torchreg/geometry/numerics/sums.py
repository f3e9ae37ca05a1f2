"""Sums of float64 rows with the bits of ``stable_sum``, which do not depend on the other rows.

``stable_sum`` adds the entries of each block of 1,024, then one block after another. Zeros behind the last entry change
nothing, and neither do blocks of zeros: rows of different lengths may stand side by side, filled up with zeros. Short
rows need no whole block: multiples of 64 are added in the same order, whatever the width of the processor's vectors (of
2 to 8 numbers, four at once).

    row_sums         of any rows, which it fills up
    padded_row_sums  of rows that are filled up to ``padded_length`` already
    sum_in_order     of a few terms each, one after another
"""

from __future__ import annotations

import torch
from torch import Tensor

BLOCK = 1024
"""Of ``stable_sum``."""

_STEP = 64


def row_sums(values: Tensor) -> Tensor:
    """Sums (...) of values (..., K) along the last of two dimensions or more."""
    count = values.shape[-1]
    return padded_row_sums(torch.nn.functional.pad(values, (0, padded_length(count) - count)))


def padded_length(count: int) -> int:
    """The length to which rows of at most ``count`` numbers are filled up with zeros."""
    step = _STEP if count <= BLOCK else BLOCK
    return max(1, -(-count // step)) * step


def padded_row_sums(values: Tensor) -> Tensor:
    """Sums (...) of rows (..., L), where L is a ``padded_length``."""
    values = values.contiguous()  # across the memory, rows would be added in another order
    if values.shape[-1] <= BLOCK:
        return values.sum(dim=-1)
    blocks = values.view(*values.shape[:-1], -1, BLOCK).sum(dim=-1)  # (..., blocks)
    return blocks.cumsum(dim=-1)[..., -1]


def sum_in_order(values: Tensor) -> Tensor:
    """Sums (..., S) of values (..., K, S), K > 0, over the last dimension but one, one after another."""
    total = torch.zeros_like(values[..., 0, :])
    for row in values.unbind(dim=-2):
        total += row
    return total
