"""A grid of cells over every cloud of a batch: points sorted by cell, and where the cells around each begin.

Cells are sorted by (cloud, z, y, x), so the 27 cells around a cell are 9 runs of the sorted points.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

# Cells are this much wider than the search radius, so that no rounding (of d^2 in float32, of cell numbers
# below 2^31 in float64) puts a neighbor two cells away.
MARGIN = 1 + 1e-5


class Grid(NamedTuple):
    """Points sorted by cell, and the surroundings of the M cells that hold points.

    Attributes:
        order: (P,) int64, rows of the points, sorted by cell.
        cell: (P,) int64, the cell of every point, 0..M-1.
        size: (M,) int64, points in every cell.
        begin: (M, 9) int64, the first place in ``order`` of each run of points around a cell.
        length: (M, 9) int64, the length of each run.
    """

    order: Tensor
    cell: Tensor
    size: Tensor
    begin: Tensor
    length: Tensor


def make_grid(points: Tensor, cloud: Tensor, limits: Tensor) -> Grid:
    """Sort points into cells a little wider than the search radius.

    Args:
        points: (P, 3), P > 0.
        cloud: (P,) int64, the cloud of every point, 0..B-1.
        limits: (B,) squared radii.

    Returns:
        Grid. Its size does not depend on the extent of the clouds: only cells that hold points exist.
    """
    cells = _cell_numbers(points, cloud, limits)
    y_bits = z_bits = (62 - len(limits).bit_length()) // 2
    x, y, z = (cells[:, axis].clamp_max(2**bits - 2) + 1 for axis, bits in ((0, 31), (1, y_bits), (2, z_bits)))
    # Two steps, since cloud, z, y and x together overflow 63 bits: number the lines along x that hold points.
    lines, line = torch.unique((((cloud << z_bits) | z) << y_bits) | y, return_inverse=True)
    keys, order = ((line << 32) | x).sort(stable=True)
    occupied, sorted_cell, size = torch.unique_consecutive(keys, return_inverse=True, return_counts=True)
    cell = torch.empty_like(order).scatter_(0, order, sorted_cell)

    steps = torch.tensor([-1, 0, 1], device=points.device)
    shifts = ((steps[:, None] << y_bits) + steps).reshape(9)  # over z and y; y and z start at 1: no borrow
    around = lines[occupied >> 32, None] + shifts  # (M, 9)
    place = torch.searchsorted(lines, around).clamp_max(len(lines) - 1)
    low = (place << 32) | ((occupied & (2**32 - 1)) - 1)[:, None]  # the cell at x - 1 of that line
    begin = torch.searchsorted(keys, low)
    length = torch.searchsorted(keys, low + 2, right=True) - begin
    return Grid(order, cell, size, begin, length.where(lines[place] == around, 0))


def _cell_numbers(points: Tensor, cloud: Tensor, limits: Tensor) -> Tensor:
    """(P, 3) int64: the cell of every point, counted from the least coordinates of its cloud."""
    position = points.double()
    owner = cloud[:, None].expand(-1, 3)
    corner = position.new_zeros(len(limits), 3).scatter_reduce(0, owner, position, "amin", include_self=False)
    edge = limits.double().sqrt() * MARGIN
    ratio = (position - corner[cloud]) / edge[cloud, None]
    return ratio.clamp_max(2.0**31).long()
