"""Sums along rows in the order of ``stable_sum``, without its copies: the memory it pads is made once and used again.

A row stands in blocks of 1,024 with zeros behind it. Blocks are added each for itself, then one after another, so a
row has its bits whatever stands beside it and however many blocks of zeros follow.
"""

from __future__ import annotations

import torch
from torch import Tensor

BLOCK = 1024
"""Of ``stable_sum``."""


class RowSums:
    """Sums of rows of at most ``width`` entries, of at most ``rows`` rows at a time; float64."""

    def __init__(self, rows: int, width: int, device: torch.device) -> None:
        self._blocks = max(1, -(-width // BLOCK))
        # two rows at least: a single sum is a full reduction, which threads may split
        self._buffer = torch.zeros(max(2, rows), self._blocks * BLOCK, dtype=torch.float64, device=device)

    def __call__(self, values: Tensor) -> Tensor:
        """Sums (R,) of values (R, K); K is the same in every call."""
        self._buffer[: len(values), : values.shape[1]] = values
        return self._sums(len(values))

    def places(self, row: Tensor, place: Tensor) -> Tensor:
        """Where entries stand for ``placed``: (T,) from their rows and their places within them."""
        return row * self._buffer.shape[1] + place

    def placed(self, values: Tensor, places: Tensor, rows: int) -> Tensor:
        """Sums (rows,) of values (T,) at ``places`` (T,); zeros at all places that no call has filled."""
        self._buffer.view(-1)[places] = values
        return self._sums(rows)

    def clear(self, places: Tensor) -> None:
        """Put zeros where a call of ``placed`` put values."""
        self._buffer.view(-1)[places] = 0.0

    def _sums(self, rows: int) -> Tensor:
        partial = self._buffer[: max(2, rows)].view(-1, self._blocks, BLOCK).sum(dim=2)[:rows]  # (R, blocks)
        return partial.cumsum(dim=1)[:, -1] if self._blocks > 1 else partial[:, 0]


def row_sums(values: Tensor) -> Tensor:
    """Sums (...) of values (..., K) along the last of two dimensions or more."""
    rows = values.flatten(0, -2)
    return RowSums(len(rows), rows.shape[1], rows.device)(rows).reshape(values.shape[:-1])
