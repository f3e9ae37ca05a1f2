"""All pairs of points in a neighborhood, which PFH and its relatives count in bins."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.pair_features import angle_edges
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather
from torchreg.types import Neighborhoods

PAIR_BINS = 5
"""Of each number of a pair."""

PAIR_CELLS = PAIR_BINS**3
"""Bins of three numbers at once; the first one moves fastest."""

PAIR_EDGES = angle_edges(PAIR_BINS)


class SlotPairs(NamedTuple):
    """The two slots of every pair of a row of K slots, M = K (K - 1) / 2 of them."""

    first: Tensor  # (M,) int64, the later slot
    second: Tensor  # (M,) int64, the earlier one


def slot_pairs(width: int, device: torch.device, begin: int = 0) -> SlotPairs:
    """Every pair of two of ``width`` slots once; from ``begin`` on, those whose later slot is not before it."""
    first, second = torch.tril_indices(width - begin, width, begin - 1, device=device)
    return SlotPairs(first + begin if begin else first, second)


class PairPiece(NamedTuple):
    """Some rows of neighborhoods, with C columns of numbers of both points of M of the pairs in each row."""

    rows: slice
    first: tuple[Tensor, ...]  # (r, M) each
    second: tuple[Tensor, ...]  # (r, M) each
    valid: Tensor  # (r, M) whether both slots are


def pair_pieces(near: Neighborhoods, columns: list[Tensor]) -> Iterator[PairPiece]:
    """Pieces that stay in the cache, with columns (P,) of the points.

    Together they hold each pair of each row once. Where a row has too many of them, several pieces share its pairs.
    """
    for later in row_chunks(near.max_neighbors, near.max_neighbors):
        pairs = slot_pairs(later.stop, near.index.device, later.start)
        for rows in row_chunks(len(near), len(pairs.first)):
            index, valid = near.index[rows, : later.stop], near.valid[rows, : later.stop]
            slots = [gather(column, index) for column in columns]
            yield PairPiece(
                rows,
                tuple(slot.index_select(1, pairs.first) for slot in slots),
                tuple(slot.index_select(1, pairs.second) for slot in slots),
                valid.index_select(1, pairs.first) & valid.index_select(1, pairs.second),
            )


def pair_cells(bins: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    """Cell 0..124 (int64) of three bins 0..4."""
    return bins[0] + bins[1] * PAIR_BINS + bins[2] * PAIR_BINS**2


def pair_share(valid: Tensor, dtype: torch.dtype) -> Tensor:
    """(R, 1) percent that one pair of valid slots (R, K) is of all of them in its row."""
    counts = valid.sum(dim=1, keepdim=True)
    pairs = counts * (counts - 1) // 2
    return 100 / pairs.clamp(min=1).to(dtype)


def used_slots(near: Neighborhoods) -> Neighborhoods:
    """Without the last slots that no row uses: pairs grow with the square of their number. Reads one number.

    Where a graph is captured, which holds for any values, all slots stay.
    """
    if torch.compiler.is_compiling() or near.index.numel() == 0:
        return near
    place = torch.arange(1, near.max_neighbors + 1, device=near.index.device)
    return near.restrict(max_neighbors=max(1, int((near.valid.any(dim=0) * place).max())))
