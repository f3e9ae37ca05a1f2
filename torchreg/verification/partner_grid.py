"""The nearest points of scans within a limit, by grids of cells: a compiled kernel alone, on the CPU.

Where a limit is known that is not many spacings wide, comparing the points of a few cells is faster than a tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.native import call
from torchreg.types.packing import offsets_of

SLACK = 1.01
"""Of a cell's width to the limit: far more than rounding."""

MARGIN = 2
"""Empty cells around a scan: one that its points reach into, one that nothing reaches into."""

_LONGEST = 4000  # cells along an axis: more would round points into other cells
_CELLS = 1 << 16  # of a scan at most, or ``_CELLS_PER_POINT`` times its points; a scan that is wider has wider cells
_CELLS_PER_POINT = 8
_WIDER = 1.25


class PartnerGrid(NamedTuple):
    """The points of G scans in cells."""

    low: Tensor  # (G, 3) float32, meters, the least coordinates
    width: Tensor  # (G,) float32, meters, of a cell
    last: Tensor  # (G, 3) float32, the last cell along each axis
    first: Tensor  # (G,) int64, where the cells of a scan begin
    entries: Tensor  # (P, 4) int32, the bits of x, y and z of every point and its row, cell by cell
    starts: Tensor  # (V + 1,) int32, where the entries of each cell begin
    reached: Tensor  # (V,) bool, whether a point lies in it or in one of the 26 around it


def partner_grid(points: Tensor, sizes: Sequence[int], limit: Tensor) -> PartnerGrid:
    """Sort the points (3, P) float32 of G scans, one after another, for searches within the limits (G,), meters."""
    parts = points.split(list(sizes), dim=1)
    low = torch.stack([part.amin(dim=1) for part in parts])
    extents = (torch.stack([part.amax(dim=1) for part in parts]) - low).tolist()
    widths, counts = [], []
    for extent, size, within in zip(extents, sizes, limit.tolist(), strict=True):
        most = max(_CELLS, _CELLS_PER_POINT * size)
        width = max(SLACK * within, max(extent) / _LONGEST)
        while _volume(_cells(extent, width)) > most:
            width *= _WIDER
        widths.append(width)
        counts.append(_cells(extent, width))
    volumes = torch.tensor([_volume(count) for count in counts])
    cells = int(volumes.sum())
    grid = PartnerGrid(
        low=low,
        width=torch.tensor(widths, dtype=torch.float32),
        last=torch.tensor(counts, dtype=torch.float32) - 1,
        first=volumes.cumsum(0) - volumes,
        entries=torch.empty(points.shape[1], 4, dtype=torch.int32),
        starts=torch.zeros(cells + 1, dtype=torch.int32),
        reached=torch.zeros(cells, dtype=torch.bool),
    )
    call("sort_into_cells", points.contiguous(), offsets_of(sizes), *grid, points.shape[1], len(sizes), cells)
    return grid


def nearest_in_grid(
    grid: PartnerGrid, pair: Tensor, moved: Tensor, valid: Tensor, square_limit: Tensor
) -> tuple[Tensor, Tensor]:
    """Rows (R, L) int64 and squared distances (R, L) as of ``partners``, ties to the lower row."""
    row = torch.empty(moved.shape[1:], dtype=torch.int64)
    square = torch.empty(moved.shape[1:], dtype=torch.float32)
    queries = (part.contiguous() for part in (moved, pair, valid, square_limit))
    call("nearest_in_cells", *queries, *grid, row, square, *row.shape)
    return row, square


def _cells(extent: Sequence[float], width: float) -> list[int]:
    """Cells along the axes; one more than there may be, since the coordinates of points are rounded."""
    return [int(length / width) + 2 + 2 * MARGIN for length in extent]


def _volume(counts: Sequence[int]) -> int:
    x, y, z = counts
    return x * y * z
