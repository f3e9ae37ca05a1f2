"""PFH and PFHRGB with gradients: pairs of neighbors whose votes pass from cell to cell.

The backward pass goes through the pairs of a few points at a time once more (``soft.rows``), so memory does not grow
with the number of pairs.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.neighbor_pairs import PAIR_BINS, PAIR_CELLS, slot_pairs, used_slots
from torchreg.descriptors.pair_features import Oriented
from torchreg.descriptors.soft.grids import grid_votes
from torchreg.descriptors.soft.pairs import ArrangedPair, arranged_pair, pair_positions
from torchreg.descriptors.soft.rows import Kernel, Piece, by_rows
from torchreg.descriptors.soft.votes import bin_shares
from torchreg.types import Neighborhoods

_GRID = (PAIR_BINS, PAIR_BINS, PAIR_BINS)


def soft_pfh(points: Tensor, normals: Tensor, near: Neighborhoods, bandwidth: float) -> Tensor:
    """(P, 125); the arguments are those of ``torchreg.pfh``."""

    def histograms(piece: Piece) -> Tensor:
        pairs = _pairs(piece)
        arranged = arranged_pair(Oriented(*pairs.first), Oriented(*pairs.second))
        return _angle_counts(arranged, pairs.votes, bandwidth) * pairs.share

    return _described(histograms, torch.cat([points, normals], dim=1), near, PAIR_CELLS)


def soft_pfhrgb(points: Tensor, normals: Tensor, colors: Tensor, near: Neighborhoods, bandwidth: float) -> Tensor:
    """(P, 250); the arguments are those of ``torchreg.pfhrgb``."""

    def one_way(first: tuple[Tensor, ...], second: tuple[Tensor, ...], votes: Tensor) -> Tensor:
        arranged = arranged_pair(Oriented(*first[:6]), Oriented(*second[:6]), exchange=False)
        ratios = [
            bin_shares(_ratio_position(one, other), PAIR_BINS, bandwidth)
            for one, other in zip(first[6:], second[6:], strict=True)
        ]
        of_color = grid_votes(ratios[::-1], votes, _GRID)
        return torch.cat([_angle_counts(arranged, votes, bandwidth), of_color], dim=1)

    def histograms(piece: Piece) -> Tensor:
        first, second, votes, share = _pairs(piece)
        return (one_way(first, second, votes) + one_way(second, first, votes)) * share

    return _described(histograms, torch.cat([points, normals, colors], dim=1), near, 2 * PAIR_CELLS)


class _Pairs(NamedTuple):
    """All pairs of a point and its neighbors, M = K (K + 1) / 2 of them."""

    first: tuple[Tensor, ...]  # C columns (r, M)
    second: tuple[Tensor, ...]  # C columns (r, M)
    votes: Tensor  # (r, M) 1 or 0
    share: Tensor  # (r, 1) percent that one of them is


def _pairs(piece: Piece) -> _Pairs:
    columns = [torch.cat([own, other], dim=1) for own, other in zip(piece.query, piece.neighbor, strict=True)]
    votes = torch.cat([torch.ones_like(piece.votes[:, :1]), piece.votes], dim=1)
    first, second = slot_pairs(votes.shape[1], votes.device)
    count = votes.detach().sum(dim=1, keepdim=True)
    return _Pairs(
        tuple(column.index_select(1, first) for column in columns),
        tuple(column.index_select(1, second) for column in columns),
        votes.index_select(1, first) * votes.index_select(1, second),
        100 / (count * (count - 1) * 0.5).clamp(min=1),
    )


def _angle_counts(pair: ArrangedPair, votes: Tensor, bandwidth: float) -> Tensor:
    """(r, 125)."""
    f1, f2, f3 = pair_positions(pair)
    shares = [
        bin_shares(f3, PAIR_BINS, bandwidth),
        bin_shares(f2, PAIR_BINS, bandwidth),
        bin_shares(f1, PAIR_BINS, bandwidth, circular=True),
    ]
    return grid_votes(shares, votes, _GRID)


def _ratio_position(first: Tensor, second: Tensor) -> Tensor:
    """The ratio of two colors in [-1, 1], scaled to [0, 1]."""
    black = second == 0
    quotient = torch.where(black, 1, first / torch.where(black, 1, second))
    above = quotient > 1
    ratio = torch.where(above, -1 / torch.where(above, quotient, 1), quotient)
    return ratio * 0.5 + 0.5


def _described(histograms: Kernel, table: Tensor, near: Neighborhoods, size: int) -> Tensor:
    if len(table) == 0:
        return table.new_empty(0, size)
    near = used_slots(near)
    slots = near.max_neighbors + 1
    return by_rows(histograms, table, near, width=slots * (slots - 1) // 2)
