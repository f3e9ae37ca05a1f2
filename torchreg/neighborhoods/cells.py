"""Hybrid search in torch alone, on any device: compare every point with those in the cells around its own.

Where many more than K points lie within the radius, a smaller one finds the K nearest too. So the search
starts with the radius expected to hold somewhat more than K, and doubles it for the points that found fewer.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from torchreg.neighborhoods.distances import squared_distances
from torchreg.neighborhoods.grid import Grid, make_grid
from torchreg.neighborhoods.select import k_smallest

SLOT_BYTES = 112  # working memory per candidate of a chunk: positions, rows, distances, the selection's copies
GROWTH = 4.0  # of the squared radius from round to round
ESTIMATES = 4  # at most so many grids to find the first radius
ROOM = 2.0  # the first radius is expected to hold this many times K points


def search_cells(
    points: Tensor,
    spans: list[tuple[int, int]],
    limits: list[float],
    max_neighbors: int,
    max_bytes: int = 256 * 2**20,
) -> tuple[Tensor, Tensor, Tensor]:
    """The K nearest with d^2 < ``limits[b]`` among the points of the same cloud.

    Args:
        points: (P, 3) float32 or float64 on any device.
        spans: the (begin, end) rows of the B clouds.
        limits: B squared radii in the precision of ``points``.
        max_neighbors: K. Of points that tie for the last place those of smaller index stay.
        max_bytes: bounds the memory of a chunk of candidates; the result does not depend on it.

    Returns:
        index (P, K) int64, valid (P, K) bool and sq_distance (P, K), as ``Neighborhoods`` holds them.
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
    """The (B,) squared radii to start with, and those that hold a whole cloud or reach the final ones.

    On a surface the disk of the search radius is about 3 cells large, and its points grow with its area. That
    is asked again of the smaller cells, since a crowded cell does not tell how its points lie in it.
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
    """Rows of similar width (number of candidates), and the largest: with K more slots a row they fit ``slots``."""
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
