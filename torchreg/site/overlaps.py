"""Which scans of a frame see the same surfaces, predicted from their poses: scans that fill the same coarse cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply

_LEAST_SHARE = 0.1  # of the cells of the scan that fills fewer
_LEAST_CELLS = 12
_MOST = 24  # pairs of a scan, those of the largest shares


class FilledCells(NamedTuple):
    """The cells of one frame that a scan fills."""

    corner: Tensor  # (C, 3) int64, multiples of the edge, each cell once


def filled_cells(points: Tensor, T_world_scan: Tensor, edge: float) -> FilledCells:
    """The cells of ``edge`` meters that points (P, 3) float64 fill under a pose (4, 4)."""
    return FilledCells(torch.floor(apply(T_world_scan, points) / edge).long().unique(dim=0))


def overlapping(cells: Sequence[FilledCells], most: int = _MOST) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of scans that share cells, in ascending order.

    Args:
        cells: of N scans of one frame, some perhaps empty.
        most: of the pairs of one scan, those that share the most stay; a pair stays that is among these of either.
    """
    count = len(cells)
    if count == 0:
        return []
    sizes = torch.tensor([len(each.corner) for each in cells])
    scan = torch.arange(count).repeat_interleave(sizes)
    every, cell = torch.cat([each.corner for each in cells]).unique(dim=0, return_inverse=True)
    shared = torch.zeros(count, count, dtype=torch.int64)
    for number in range(count):
        filled = torch.zeros(len(every), dtype=torch.bool)
        filled[cell[scan == number]] = True
        shared[number] = torch.bincount(scan[filled[cell]], minlength=count)
    share = shared / torch.minimum(sizes[:, None], sizes).clamp(min=1)
    share = torch.where((shared >= _LEAST_CELLS) & (share >= _LEAST_SHARE), share, 0.0).fill_diagonal_(0.0)
    rank = share.argsort(dim=1, descending=True, stable=True).argsort(dim=1)
    kept = (share > 0) & (rank < most)
    return [(i, j) for i, j in (kept | kept.t()).triu(1).nonzero().tolist()]
