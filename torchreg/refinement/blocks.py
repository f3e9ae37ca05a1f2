"""The source rows of all pairs in blocks of 256, each block of one pair, and the sum over each pair in a fixed order.

Whole blocks let one elementwise pass serve the packed batch, with one transform per block. The order in which a
pair's rows are added follows from its own rows alone, so its sums have the same bits in any batch and with any
number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import CACHE_ELEMENTS, row_chunks
from torchreg.geometry.numerics.sums import lane_sums

BLOCK = 256
_CHUNK_WIDTH = 8  # temporaries of a row that should stay in the cache together


@dataclass(frozen=True, eq=False)
class Blocks:
    """The blocks of every pair."""

    pair: Tensor  # (n,) int64, ascending
    real: Tensor  # (n, 256) bool, false for the rows that fill up the last block of a pair
    counts: tuple[int, ...]  # the number of blocks of every pair

    @staticmethod
    def of(lengths: list[int], device: torch.device) -> Blocks:
        """Blocks for pairs of these numbers of rows, each at least 1."""
        counts = tuple(-(-length // BLOCK) for length in lengths)
        real = torch.zeros(sum(counts) * BLOCK, dtype=torch.bool, device=device)
        begin = 0
        for length, count in zip(lengths, counts, strict=True):
            real[begin : begin + length] = True
            begin += count * BLOCK
        return Blocks(_numbers(counts, device), real.view(-1, BLOCK), counts)

    def fill(self, values: Tensor) -> Tensor:
        """Packed values (P, C) spread over the blocks: (C, n, 256) float64, zero where rows only fill up."""
        out = values.new_zeros(values.shape[1], self.real.numel(), dtype=torch.float64)
        out[:, self.real.view(-1)] = values.t().double()
        return out.view(values.shape[1], *self.real.shape)

    def keep(self, pairs: list[int]) -> tuple[Blocks, Tensor]:
        """The blocks of some pairs, ascending, and the places of these blocks in this object."""
        device = self.pair.device
        ends = torch.tensor(self.counts).cumsum(0).tolist()
        parts = [torch.arange(ends[b] - self.counts[b], ends[b]) for b in pairs]
        chosen = (torch.cat(parts) if parts else torch.zeros(0, dtype=torch.int64)).to(device)
        counts = tuple(self.counts[b] for b in pairs)
        return Blocks(_numbers(counts, device), self.real[chosen], counts), chosen

    def chunks(self) -> Iterator[slice]:
        """Slices of blocks that stay in the cache; on other devices, all blocks."""
        elements = CACHE_ELEMENTS if self.pair.device.type == "cpu" else 1 << 28
        return row_chunks(len(self.pair), BLOCK * _CHUNK_WIDTH, elements)

    def sums(self, terms: Callable[[slice], Tensor], channels: int) -> Tensor:
        """Sums (B, C) over the rows of every pair of ``terms(chunk)`` (C, k, 256), float64."""
        partial = torch.zeros(channels, len(self.pair), dtype=torch.float64, device=self.pair.device)
        for chunk in self.chunks():
            partial[:, chunk] = lane_sums(terms(chunk))
        padded = partial.new_zeros(channels, len(self.counts), max(self.counts))
        first = torch.tensor((0, *self.counts[:-1]), device=self.pair.device).cumsum(0)
        place = torch.arange(len(self.pair), device=self.pair.device) - first[self.pair]
        padded[:, self.pair, place] = partial
        return lane_sums(padded).t()  # (B, C)


def dot(left: Tensor, right: Tensor) -> Tensor:
    """Products (...) of vectors (3, ...), in a fixed order."""
    x, y, z = (left * right).unbind(0)
    return x + y + z


def turned(rotation: Tensor, vectors: Tensor) -> Tensor:
    """Vectors (3, k, 256) turned by the rotations (k, 3, 3) of their blocks."""
    x, y, z = vectors.unbind(0)
    R = rotation[..., None]  # (k, 3, 3, 1)
    return torch.stack([R[:, i, 0] * x + R[:, i, 1] * y + R[:, i, 2] * z for i in range(3)])


def _numbers(counts: tuple[int, ...], device: torch.device) -> Tensor:
    each = torch.tensor(counts, dtype=torch.int64)
    return torch.arange(len(counts)).repeat_interleave(each).to(device)
