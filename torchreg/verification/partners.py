"""The nearest points of scans to moved points, of all pairs at once: cells rule most out, trees search the rest.

Most points under a wrong pose have no partner within the threshold. Looking up their cell takes a fraction of the time
of a search, and searches from far away take longest.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.native import call, native
from torchreg.neighborhoods.point_index import PointIndex
from torchreg.types.packing import offsets_of
from torchreg.verification.candidates import runs_of
from torchreg.verification.partner_grid import MARGIN, SLACK, PartnerGrid, nearest_in_grid, partner_grid

_MOST = 64  # cells along an axis; a scan that is wider has wider cells


class Occupancy(NamedTuple):
    """Cells of space in which a query can have a partner, of G scans."""

    low: Tensor  # (3, G) float32, meters, the least coordinates
    width: Tensor  # (G,) float32, meters
    last: Tensor  # (3, G) float32, the last cell along each axis
    stride: Tensor  # (3, G) int64, from a cell to the next along each axis
    first: Tensor  # (G,) int64, where the cells of a scan begin
    reached: Tensor  # of all cells, whether a point lies in it or in one of the 26 around it


class PartnerSearch:
    """The points of G scans, in which ``partners`` searches: by a grid where kernels run, else by cells and trees."""

    def __init__(self, points: Tensor, sizes: Sequence[int], threshold: Tensor) -> None:
        """Take the points (3, P) float32 of scans one after another, and the thresholds (G,) float64, meters."""
        self._points, self._sizes, self._threshold = points, sizes, threshold
        self.first: list[int] = offsets_of(sizes)[:-1].tolist()
        """The row of every scan's first point among the points of all."""

    @cached_property
    def grid(self) -> PartnerGrid:
        """For compiled searches."""
        return partner_grid(self._points, self._sizes, self._threshold)

    @cached_property
    def occupancy(self) -> Occupancy:
        """Where partners can be."""
        return occupancy(self._points, self._sizes, self._threshold)

    @cached_property
    def trees(self) -> list[PointIndex]:
        """Over the points of every scan."""
        return [PointIndex(part.t().contiguous()) for part in self._points.split(list(self._sizes), dim=1)]


class Partners(NamedTuple):
    """The nearest points of queries, of those that have one within the limit."""

    row: Tensor  # (R, L) int64, among the points of all scans; any legal row where there is none
    square: Tensor  # (R, L) squared meters, of others infinite or not below the squared limit


def partners(search: PartnerSearch, pair: Tensor, moved: Tensor, valid: Tensor, square_limit: Tensor) -> Partners:
    """Find the nearest point of every query, ``moved`` (3, R, L) float32 in the frames of the scans, meters.

    ``pair`` (R,) ascends, the pair that each row of queries belongs to; ``valid`` (R, L) is false behind its end.
    ``square_limit`` (R,) float32 are squares of the thresholds of the search, or less. Where several points are equally
    near, kernels take the lowest row, a tree may take another.
    """
    if native(moved, pair, valid, square_limit):
        return Partners(*nearest_in_grid(search.grid, pair, moved, valid, square_limit))
    asked = (can_be_near(search.occupancy, pair, moved) & valid).view(-1).nonzero()[:, 0]  # (Q,)
    queries = moved.view(3, -1).index_select(1, asked).t().contiguous()
    row, square = torch.zeros_like(asked), queries.new_zeros(len(asked))
    runs = runs_of(pair)
    ends = torch.tensor([run.end for run in runs], device=pair.device) * moved.shape[2]
    begin = 0
    for run, end in zip(runs, torch.searchsorted(asked, ends).tolist(), strict=True):
        if end > begin:
            nearest = search.trees[run.pair].nearest(queries[begin:end])
            torch.add(nearest.index, search.first[run.pair], out=row[begin:end])
            square[begin:end] = nearest.sq_distance
        begin = end
    rows = torch.zeros(moved.shape[1:], dtype=torch.int64, device=moved.device)
    squares = torch.full_like(moved[0], float("inf"))
    rows.view(-1)[asked], squares.view(-1)[asked] = row, square
    return Partners(rows, squares)


def occupancy(points: Tensor, sizes: Sequence[int], threshold: Tensor) -> Occupancy:
    """Mark the cells near the points (3, P) float32 of G scans, one after another, of at least one point each."""
    device = points.device
    parts = points.split(list(sizes), dim=1)
    low = torch.stack([part.amin(dim=1) for part in parts], dim=1)  # (3, G)
    extent = torch.stack([part.amax(dim=1) for part in parts], dim=1) - low
    width = torch.maximum((SLACK * threshold).to(points.dtype), extent.amax(dim=0) / _MOST)
    last = torch.floor(extent / width) + 2 * MARGIN
    counts = last.long() + 1
    stride = torch.stack([counts[1] * counts[2], counts[2], torch.ones_like(counts[2])])
    volumes = counts.prod(dim=0)
    reached = torch.zeros(int(volumes.sum()), dtype=torch.bool, device=device)
    cells = Occupancy(low, width, last, stride, volumes.cumsum(0) - volumes, reached)
    if native(points):
        call("mark_reached", points.contiguous(), offsets_of(sizes), *cells, points.shape[1], len(sizes), len(reached))
        return cells
    scan = torch.arange(len(sizes), device=device).repeat_interleave(torch.tensor(sizes, device=device))
    middle, stride = _cell(cells, scan, points), stride[:, scan]
    for steps in product((-1, 0, 1), repeat=3):
        reached[middle + sum(step * along for step, along in zip(steps, stride, strict=True))] = True
    return cells


def can_be_near(cells: Occupancy, scan: Tensor, queries: Tensor) -> Tensor:
    """False (R, N) where no point of a row's scan (R,) is nearer to the query (3, R, N) than the threshold."""
    return cells.reached.index_select(0, _cell(cells, scan[:, None], queries).view(-1)).view(queries.shape[1:])


def near_counts(cells: Occupancy, scan: Tensor, queries: Tensor, valid: Tensor) -> Tensor:
    """How many (R,) int64 of the queries (3, R, N), where ``valid`` (R, N), ``can_be_near``."""
    if native(queries):
        return _counts_compiled(cells, scan, queries, valid)
    return (can_be_near(cells, scan, queries) & valid).sum(dim=1)


def _counts_compiled(cells: Occupancy, scan: Tensor, queries: Tensor, valid: Tensor) -> Tensor:
    """As ``near_counts``."""
    counts = torch.empty_like(scan)
    parts = (queries.contiguous(), scan, valid.contiguous())
    call("near_counts", *parts, *cells, counts, len(cells.first), *queries.shape[1:])
    return counts


def _cell(cells: Occupancy, scan: Tensor, points: Tensor) -> Tensor:
    """The cells (...) of points (3, ...), among all; beyond the margin, one at its edge."""
    cell = cells.first[scan]
    for axis, low, last, stride in zip(points, cells.low, cells.last, cells.stride, strict=True):
        place = torch.floor((axis - low[scan]) / cells.width[scan]).add_(MARGIN)
        place = torch.where(place > 0, place, 0.0)  # also where it is not a number
        cell = cell + torch.minimum(place, last[scan]).long() * stride[scan]
    return cell
