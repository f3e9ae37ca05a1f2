"""Which scans of a frame see the same surfaces, predicted from their poses: scans that fill the same coarse cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply, apply_rotation

_LEAST_SHARE = 0.1  # of the cells of the scan that fills fewer
_LEAST_CELLS = 12
_MOST = 24  # pairs of a scan, those of the largest shares


class FilledCells(NamedTuple):
    """The cells of one frame that the surfaces of a scan fill."""

    cell: Tensor  # (C, 4) int64, the corner in multiples of the edge and the axis that the surface faces, each once


def filled_cells(points: Tensor, normals: Tensor, T_world_scan: Tensor, edge: float, *, faced: bool) -> FilledCells:
    """The cells of ``edge`` meters that surfaces fill under a pose (4, 4).

    A cell has a place for surfaces across each axis, and where they are ``faced`` for either side: so scans of two
    rooms do not share the wall between them.

    Args:
        points: (P, 3) float64, meters.
        normals: (P, 3) of unit length; towards the scanner where ``faced``.
        T_world_scan: (4, 4) float64.
        edge: meters.
        faced: whether the sign of normals counts.
    """
    corner = torch.floor(apply(T_world_scan, points) / edge).long()
    turned = apply_rotation(T_world_scan[:3, :3], normals.double())
    axis = turned.abs().argmax(dim=1, keepdim=True)
    away = turned.gather(1, axis) < 0
    side = 2 * axis + away if faced else axis
    return FilledCells(torch.cat([corner, side], dim=1).unique(dim=0))


def overlapping(cells: Sequence[FilledCells], most: int = _MOST) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of scans that share cells, in ascending order.

    Args:
        cells: of N scans of one frame, some perhaps empty.
        most: of the pairs of one scan, those that share the most stay; a pair stays that is among these of either.
    """
    count = len(cells)
    if count == 0:
        return []
    sizes = torch.tensor([len(each.cell) for each in cells])
    scan = torch.arange(count).repeat_interleave(sizes)
    every, cell = torch.cat([each.cell for each in cells]).unique(dim=0, return_inverse=True)
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
