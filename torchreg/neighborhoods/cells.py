"""Hybrid search in torch alone, on any device: compare every point with those in the cells around its own.

Points are sorted by cell, cells by (cloud, z, y, x), so the 27 cells around a cell are 9 runs of the sorted points.
Where many more than K points lie within the radius, a smaller one finds the K nearest too. So the search
starts with the radius expected to hold somewhat more than K, and doubles it for the points that found fewer.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.neighborhoods.distances import sort_rows, squared_distances

SLOT_BYTES = 112  # working memory per candidate of a chunk: positions, rows, distances, the selection's copies
GROWTH = 4.0  # of the squared radius from round to round
ESTIMATES = 4  # at most so many grids to find the first radius
ROOM = 2.0  # the first radius is expected to hold this many times K points

# Cells are this much wider than the search radius, so that no rounding (of d^2 in float32, of cell numbers
# below 2^31 in float64) puts a neighbor two cells away.
MARGIN = 1 + 1e-5


def search_cells(
    points: Tensor,
    spans: list[tuple[int, int]],
    limits: list[float],
    max_neighbors: int,
    max_bytes: int = 256 * 2**20,
) -> tuple[Tensor, Tensor, Tensor]:
    """Index, valid and sq_distance (P, K), as ``Neighborhoods`` holds them, of the nearest in every point's own cloud.

    Points (P, 3) are float32 or float64 on any device; ``spans`` are the (begin, end) rows of the B clouds, ``limits``
    their squared radii in the precision of the points: d^2 < ``limits[b]``. K is ``max_neighbors``; of points that tie
    for the last place those of smaller index stay. ``max_bytes`` bounds the memory of a chunk of candidates; the result
    does not depend on it.
    """
    rows, device = points.shape[0], points.device
    index = torch.arange(rows, device=device)[:, None].repeat(1, max_neighbors)
    sq_distance = points.new_zeros(rows, max_neighbors)
    valid = torch.zeros(rows, max_neighbors, dtype=torch.bool, device=device)
    if rows == 0:
        return index, valid, sq_distance
    slots = max(1, max_bytes // SLOT_BYTES)
    lengths = torch.tensor([end - begin for begin, end in spans], device=device)
    cloud = torch.repeat_interleave(torch.arange(len(spans), device=device), lengths, output_size=rows)
    final = torch.tensor(limits, dtype=points.dtype, device=device)
    axes = points.t().contiguous()
    limit, enclosing = _first_limits(points, cloud, final, max_neighbors)
    active = torch.arange(rows, device=device)
    while len(active) > 0:
        grid = make_grid(points, cloud, limit)
        for chunk, width in _chunks(grid, active, max_neighbors, slots):
            reach = limit[cloud[chunk]][:, None]  # (R, 1)
            squares, near = _nearest_in_cells(axes, grid, chunk, width, max_neighbors, slots)
            inside = squares < reach
            index[chunk] = near.where(inside, chunk[:, None])
            valid[chunk] = inside
            sq_distance[chunk] = squares.where(inside, 0)
        active = active[~valid[active, -1] & (limit < final)[cloud[active]]]
        last = len(active) * rows <= slots  # few enough to compare with all points at once
        limit = final if last else torch.where(GROWTH * limit < enclosing, GROWTH * limit, final)
    return index, valid, sq_distance


def _first_limits(points: Tensor, cloud: Tensor, final: Tensor, max_neighbors: int) -> tuple[Tensor, Tensor]:
    """The (B,) squared radii to start with, and those that hold a whole cloud or equal the final ones.

    On a surface the disk of the search radius covers about 3 cells, and its points grow with its area. The estimate
    is repeated with the smaller cells, since the number of points in a cell does not say how they lie in it.
    """
    clouds = len(final)
    owner = cloud[:, None].expand(-1, 3)
    low, high = (
        points.new_zeros(clouds, 3).scatter_reduce(0, owner, points, reduce, include_self=False)
        for reduce in ("amin", "amax")
    )
    diagonal = ((high - low) ** 2).sum(dim=1) * 1.01
    enclosing = torch.where((diagonal > 0) & (diagonal < final), diagonal, final)
    total = torch.zeros(clouds, dtype=torch.int64, device=points.device).scatter_add_(0, cloud, torch.ones_like(cloud))
    limit = enclosing
    for _ in range(ESTIMATES):
        grid = make_grid(points, cloud, limit)
        crowd = torch.zeros_like(total).scatter_add_(0, cloud, grid.size[grid.cell])
        share = ROOM * max_neighbors / (3 * crowd / total.clamp_min(1)).clamp_min(1)
        smaller = (limit * share.to(limit.dtype)).clamp_min(torch.finfo(final.dtype).tiny)
        limit = torch.where(share < 0.5, smaller, limit)
        if not bool((share < 0.5).any()):
            break
    return torch.where(limit < enclosing, limit, final), enclosing


def _chunks(grid: Grid, active: Tensor, max_neighbors: int, slots: int) -> Iterator[tuple[Tensor, int]]:
    """Rows of similar width (number of candidates) and the widest; with K slots more a row they fit ``slots``."""
    widths, by_width = grid.length.sum(dim=1)[grid.cell[active]].sort(descending=True, stable=True)
    active, descending, begin = active[by_width], widths.cpu(), 0
    while begin < len(active):
        width = int(descending[begin])
        rows = active[begin : begin + max(1, slots // (width + max_neighbors))]
        yield rows, width
        begin += len(rows)


def _nearest_in_cells(
    axes: Tensor, grid: Grid, rows: Tensor, width: int, max_neighbors: int, slots: int
) -> tuple[Tensor, Tensor]:
    """The K nearest (R, K) of some rows in the cells around them; infinite where these hold fewer."""
    cell = grid.cell[rows]
    ends = grid.length[cell].cumsum(dim=1)  # (R, 9): candidates up to the end of each run
    shift = grid.begin[cell] + grid.length[cell] - ends  # (R, 9): from a candidate's number to its place
    best, index = axes.new_full((len(rows), max_neighbors), torch.inf), rows[:, None].repeat(1, max_neighbors)
    step = max(1, slots // len(rows) - max_neighbors)
    for low in range(0, width, step):
        number = torch.arange(low, min(low + step, width), device=axes.device).repeat(len(rows), 1)  # (R, W)
        run = torch.searchsorted(ends, number, right=True)
        exists = run < 9
        place = number + shift.gather(1, run.clamp_max(8))
        candidates = grid.order[place.where(exists, 0)]
        squares = squared_distances(axes, rows, candidates).where(exists, torch.inf)
        best, index = k_smallest(
            torch.cat([best, squares], dim=1), torch.cat([index, candidates], dim=1), max_neighbors
        )
    return best, index


def k_smallest(values: Tensor, index: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The ``count`` smallest of every row of values (R, W), and their indexes, ascending by (value, index).

    Values are infinite where there is no candidate; indexes are 0 and above. ``torch.topk`` leaves open which of equal
    values it takes, so it only finds the last value that is in; a second selection then takes all below it and, of
    those equal to it, the smallest indexes.
    """
    last = values.topk(count, dim=1, largest=False).values[:, -1:]
    rank = index.where(values == last, torch.iinfo(torch.int64).max).masked_fill_(values < last, -1)
    taken = rank.topk(count, dim=1, largest=False).indices
    return sort_rows(values.gather(1, taken), index.gather(1, taken))


class Grid(NamedTuple):
    """Points sorted by cell, and where the runs around each of the M cells that hold points begin."""

    order: Tensor  # (P,) int64, rows of the points, sorted by cell
    cell: Tensor  # (P,) int64, the cell of every point, 0..M-1
    size: Tensor  # (M,) int64, points in every cell
    begin: Tensor  # (M, 9) int64, the first place in ``order`` of each run of points around a cell
    length: Tensor  # (M, 9) int64, the length of each run


def make_grid(points: Tensor, cloud: Tensor, limits: Tensor) -> Grid:
    """Sort points (P, 3), P > 0, into cells a little wider than the search radius of their cloud.

    ``cloud`` (P,) int64 is the cloud of every point, ``limits`` (B,) the squared radii. The size of the grid does not
    depend on the extent of the clouds: only cells that hold points exist.
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
