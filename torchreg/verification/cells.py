"""Where a scan has points nearby at all: cells of space in which a query can have a partner within the threshold.

Most points under a wrong pose have no partner. To look up their cells takes a fraction of the time of a search, and
a search from far away takes longest.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor

_SLACK = 1.01  # of a cell's width to the threshold: far more than rounding
_MOST = 64  # cells along an axis; a scan that is wider has wider cells
_MARGIN = 2  # empty cells around a scan: one that its points reach into, one that nothing reaches into


class Cells(NamedTuple):
    """The cells of G scans.

    Attributes:
        low: (3, G) float32, meters, the least coordinates.
        width: (G,) float32, meters.
        last: (3, G) float32, the last cell along each axis.
        stride: (3, G) int64, from a cell to the next along each axis.
        first: (G,) int64, where the cells of a scan begin.
        reached: of all cells, whether a point lies in it or in one of the 26 around it.
    """

    low: Tensor
    width: Tensor
    last: Tensor
    stride: Tensor
    first: Tensor
    reached: Tensor


def cells_of(points: Tensor, lengths: Sequence[int], threshold: Tensor) -> Cells:
    """Of G scans, one after another, of at least one point each.

    Args:
        points: (3, P) float32, meters.
        lengths: points of each scan.
        threshold: (G,) meters.
    """
    device = points.device
    parts = points.split(list(lengths), dim=1)
    low = torch.stack([part.amin(dim=1) for part in parts], dim=1)  # (3, G)
    extent = torch.stack([part.amax(dim=1) for part in parts], dim=1) - low
    width = torch.maximum((_SLACK * threshold).to(points.dtype), extent.amax(dim=0) / _MOST)
    last = torch.floor(extent / width) + 2 * _MARGIN
    counts = last.long() + 1
    stride = torch.stack([counts[1] * counts[2], counts[2], torch.ones_like(counts[2])])
    sizes = counts.prod(dim=0)
    blank = torch.zeros(int(sizes.sum()), dtype=torch.bool, device=device)
    cells = Cells(low, width, last, stride, sizes.cumsum(0) - sizes, blank)
    scan = torch.arange(len(lengths), device=device).repeat_interleave(torch.tensor(lengths, device=device))
    middle, stride = _cell(cells, scan, points), stride[:, scan]
    for steps in product((-1, 0, 1), repeat=3):
        blank[middle + sum(step * along for step, along in zip(steps, stride, strict=True))] = True
    return cells


def can_be_near(cells: Cells, scan: Tensor, queries: Tensor) -> Tensor:
    """False (R, N) where no point of a row's scan (R,) is nearer to the query (3, R, N) than the threshold."""
    return cells.reached.index_select(0, _cell(cells, scan[:, None], queries).view(-1)).view(queries.shape[1:])


def _cell(cells: Cells, scan: Tensor, points: Tensor) -> Tensor:
    """The cells (...) of points (3, ...), among all; beyond the margin, one at its edge."""
    found = cells.first[scan]
    for axis, low, last, stride in zip(points, cells.low, cells.last, cells.stride, strict=True):
        place = torch.floor((axis - low[scan]) / cells.width[scan]).add_(_MARGIN)
        place = torch.where(place > 0, place, 0.0)  # also where it is not a number
        found = found + torch.minimum(place, last[scan]).long() * stride[scan]
    return found
