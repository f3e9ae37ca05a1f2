"""Exact nearest neighbors in feature space, from tiles of a matrix product.

The product is rounded in a way that depends on the shape of the tile and the number of threads. So it only proposes a
few more candidates than are wanted; distances in float64, computed elementwise from the given features, decide among
them. The result is therefore the same for any tile and any number of threads.

Rows with still more candidates within the bound on the rounding go to ``settle_ties``. Scans of walls have thousands
of nearly or exactly equal features. So there the product is taken in float64, about the median of the queries, where
such a crowd is, and over a table sorted by distance from that median: rows no farther than d from a query lie between
two spheres, hence in a slice. Equal rows are taken together. Ties go to the lower row.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.matching.product import Product, least, product

_MORE = 2  # candidates beyond those asked for
_TILE_ELEMENTS = 1 << 20  # 4 MB of float32: measured fastest on two cores, between 2^19 and 2^22
_ROWS = 128
_CANDIDATES = 1 << 18


class FeatureNearest(NamedTuple):
    """The nearest rows of the other set for every row."""

    row: Tensor  # (N, K) int64, ascending by (distance, row)
    distance: Tensor  # (N, K) float64, Euclidean
    clear: Tensor  # (N,) bool, the product alone separates the row's nearest from all others
    # (K, M) entries of the product, per row of the table the least over the queries, without the nearest of clear
    # queries: at most one of a tile, ascending; infinity where there are fewer
    others: Tensor
    factors: Product  # of the product


def feature_nearest(query: Tensor, table: Tensor, count: int = 1) -> FeatureNearest:
    """The exact ``count`` nearest rows of ``table`` (M, D) for every ``query`` (N, D); N, M >= 1. No gradients.

    There are as many as the table has rows where that is fewer.
    """
    query, table = query.detach(), table.detach()
    count = min(count, len(table))
    several = min(count + _MORE, len(table))
    factors = product(query, table, table.double().mean(dim=0), torch.float32)
    row = torch.empty(len(query), several, dtype=torch.int64, device=query.device)
    value = factors.left.new_empty(len(query), several)
    limit = torch.empty(len(query), dtype=torch.float64, device=query.device)
    others = factors.left.new_full((count, len(table)), float("inf"))
    longest = factors.right_norm.amax()
    for rows, tile in _tiles(factors.left, factors.right):
        value[rows], row[rows] = least(tile, factors.width, several)
        last, norm = value[rows, count - 1].double(), factors.left_norm[rows]
        limit[rows] = last + 2 * factors.error(norm, factors.reach(norm, last, longest))
        told_apart = _clear(value[rows], limit[rows], count)[:, None]
        tile.scatter_(1, row[rows, :count], value[rows, :count].masked_fill(told_apart, float("inf")))
        _merge(others, tile.amin(dim=0)[: len(table)])
    clear = _clear(value, limit, count)
    row, distance = _decide(query, table, row, value <= limit[:, None], count)
    if several < len(table):
        tied = (value[:, -1] <= limit).nonzero()[:, 0]
        if len(tied) > 0:
            row[tied], distance[tied] = settle_ties(query[tied], table, count, distance[tied, -1])
    return FeatureNearest(row, distance, clear, others, factors)


def settle_ties(query: Tensor, table: Tensor, count: int, bound: Tensor) -> tuple[Tensor, Tensor]:
    """The ``count`` nearest rows of ``table`` (M, D) for every ``query`` (N, D): rows (N, count) and distances float64.

    At least ``count`` rows are no farther than ``bound`` (N,) float64. Ascending by (distance, row).
    """
    center = query.double().median(dim=0).values
    norm, outward = row_distance(query, center).sort()
    query, bound = query[outward], bound[outward]
    apart, number = row_distance(table, center).sort(stable=True)
    table = table[number]
    starts = torch.cat([number.new_ones(1).bool(), (table[1:] != table[:-1]).any(dim=1)])  # of runs of equal rows
    first = starts.nonzero()[:, 0]
    copies = first.diff(append=first.new_tensor([len(table)])).clamp(max=count)
    apart, table = apart[first], table[first]
    factors = product(query, table, center, torch.float64)
    row = torch.empty(len(query), count, dtype=torch.int64, device=query.device)
    distance = torch.empty(len(query), count, dtype=torch.float64, device=query.device)
    far = bound / factors.scale
    farthest = far.square() + factors.error(factors.left_norm, far)
    longest = factors.right_norm.amax()
    for rows, columns in _slices(norm, bound, apart):
        tile = factors.left[rows] @ factors.right[:, columns]  # (R, C)
        length, limit = factors.left_norm[rows], farthest[rows]
        if tile.shape[1] >= count:
            last = tile.topk(count, largest=False).values[:, -1]
            limit = torch.minimum(limit, last + 2 * factors.error(length, factors.reach(length, last, longest)))
        near, candidate = (tile <= limit[:, None]).nonzero().unbind(1)
        candidate = candidate + columns.start
        exact = pair_distance(query[rows], table, near, candidate)
        # every copy of a candidate counts
        pair = torch.arange(len(near), device=near.device).repeat_interleave(copies[candidate])
        near, exact, listed = near[pair], exact[pair], number[first[candidate[pair]] + rank(pair)]
        order = lexicographic(listed, exact, near)
        near, exact, listed = near[order], exact[order], listed[order]
        place = rank(near)
        kept = place < count
        row[rows][near[kept], place[kept]] = listed[kept]
        distance[rows][near[kept], place[kept]] = exact[kept]
    inward = outward.argsort()
    return row[inward], distance[inward]


def lexicographic(*keys: Tensor) -> Tensor:
    """The order (K,) that sorts by the last key, ties by the one before it, and so on."""
    order = keys[0].argsort(stable=True)
    for key in keys[1:]:
        order = order[key[order].argsort(stable=True)]
    return order


def rank(group: Tensor) -> Tensor:
    """Place (K,) of every element within its group; ``group`` (K,) int64 ascends."""
    places = torch.arange(len(group), device=group.device)
    _, number = group.unique_consecutive(return_inverse=True)
    begin = torch.full_like(places, len(group)).scatter_reduce_(0, number, places, "amin")
    return places - begin[number]


def row_distance(left: Tensor, right: Tensor) -> Tensor:
    """Euclidean distances (N,) float64 of rows (N, D); terms are added in the order of the columns."""
    difference = left.double() - right.double()
    return (difference * difference).cumsum(dim=1)[:, -1].sqrt()


def pair_distance(left: Tensor, right: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """Exact distances (K,) float64 of rows ``left[i]`` and ``right[j]``, in pieces of bounded memory."""
    pieces = zip(i.split(_CANDIDATES), j.split(_CANDIDATES), strict=True)
    return torch.cat([row_distance(left.index_select(0, one), right.index_select(0, other)) for one, other in pieces])


def _clear(value: Tensor, limit: Tensor, count: int) -> Tensor:
    """Rows (N,) whose ``count`` nearest the product separates from all others."""
    return value[:, count] > limit if count < value.shape[1] else torch.ones_like(limit, dtype=torch.bool)


def _merge(ascending: Tensor, new: Tensor) -> None:
    """Put ``new`` (M,) among the least ones (K, M), in place."""
    for place in ascending:
        larger = torch.maximum(place, new)
        torch.minimum(place, new, out=place)
        new = larger


def _decide(query: Tensor, table: Tensor, row: Tensor, candidate: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The nearest ``count`` of the candidates among (N, S) rows, by exact distance, then by row."""
    candidate[:, :count] = True
    i, place = candidate.nonzero().unbind(1)
    distance = torch.full(row.shape, float("inf"), dtype=torch.float64, device=row.device)
    distance[i, place] = pair_distance(query, table, i, row[i, place])
    row, order = row.sort(dim=1)
    distance, nearer = distance.gather(1, order).sort(dim=1, stable=True)
    return row.gather(1, nearer)[:, :count], distance[:, :count]


def _tiles(left: Tensor, right: Tensor) -> Iterator[tuple[slice, Tensor]]:
    """Yield slices of rows and their part of ``left`` @ ``right``, in one buffer that the next tile overwrites."""
    tiles = list(row_chunks(len(left), right.shape[1], _TILE_ELEMENTS))
    buffer = left.new_empty(tiles[0].stop, right.shape[1])
    for rows in tiles:
        yield rows, torch.mm(left[rows], right, out=buffer[: rows.stop - rows.start])


def _slices(norm: Tensor, bound: Tensor, apart: Tensor) -> Iterator[tuple[slice, slice]]:
    """Yield slices of ascending ``norm`` (N,), and of ascending ``apart`` (M,) no farther from them than ``bound``."""
    step = min(_ROWS, max(1, _TILE_ELEMENTS // len(apart)))
    slack = 1e-12 * (norm + bound)  # far above the rounding of either
    low, high = norm - bound - slack, norm + bound + slack
    begins = range(0, len(norm), step)
    first = torch.searchsorted(apart, torch.stack([low[k : k + step].amin() for k in begins])).tolist()
    last = torch.searchsorted(apart, torch.stack([high[k : k + step].amax() for k in begins]), right=True).tolist()
    for begin, *columns in zip(begins, first, last, strict=True):
        yield slice(begin, min(begin + step, len(norm))), slice(*columns)
