"""Exact nearest neighbors in feature space, from tiles of a matrix product.

The product gives |a|^2 + |b|^2 - 2 a.b for a tile of rows against all of the other set, up to rounding that depends
on the shape of the tile and the number of threads. So it only proposes: where a second candidate lies within the
bound on that rounding, all such candidates are compared by distances computed elementwise in float64, ties to
the lower index. The answer is therefore the same for any tile and any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

_TILE_ELEMENTS = 1 << 20  # 4 MB of float32: measured fastest on two cores, between 2^19 and 2^22


class FeatureNearest(NamedTuple):
    """The nearest row of the other set for every row.

    Attributes:
        row: (N,) int64.
        distance: (N,) float64, Euclidean.
        second: (N,) float64, distance to the second nearest (infinity when there is none): exact where asked
            for, else read off the product.
        contended: (N,) bool; false where another query is certainly nearer to this row's nearest, which rules
            a mutual match out.
    """

    row: Tensor
    distance: Tensor
    second: Tensor
    contended: Tensor


def feature_nearest(query: Tensor, table: Tensor, *, exact_second: bool = False) -> FeatureNearest:
    """The exact nearest row of ``table`` (M, D) for every row of ``query`` (N, D); M >= 1. No gradients.

    ``exact_second`` settles the second nearest as well, which a ratio test decides by.
    """
    query, table = query.detach(), table.detach()
    a, b = (query * query).sum(dim=1, keepdim=True), (table * table).sum(dim=1, keepdim=True)
    left = torch.cat([query, torch.ones_like(a), a], dim=1)  # (N, D + 2)
    right = torch.cat([-2 * table, b, torch.ones_like(b)], dim=1).t().contiguous()  # (D + 2, M)
    tolerance = _rounding_bound(a, b, query.shape[1])

    row = torch.empty(len(query), dtype=torch.int64, device=query.device)
    least, second = torch.empty_like(a[:, 0]), torch.empty_like(a[:, 0])
    settled = torch.empty(len(query), dtype=torch.float64, device=query.device)
    column = torch.full_like(b[:, 0], float("inf"))
    step = max(1, _TILE_ELEMENTS // len(table))
    buffer = left.new_empty(min(step, len(left)), len(table))
    for begin in range(0, len(left), step):
        rows = slice(begin, min(begin + step, len(left)))
        tile = torch.mm(left[rows], right, out=buffer[: rows.stop - begin])
        torch.minimum(column, tile.amin(dim=0), out=column)
        best, place = tile.min(dim=1)
        close = _settle_second(tile, place, best, tolerance, second[rows])
        if bool(close.any()):
            _settle_ties(query[rows], table, tile, best, tolerance, close, place)
        row[rows], least[rows] = place, best
        if exact_second:
            settled[rows] = _exact_second(query[rows], table, tile, second[rows] + tolerance, place)
    distance = row_distance(query, table[row])
    contended = least <= column[row] + 2 * tolerance
    return FeatureNearest(row, distance, settled if exact_second else second.double().clamp(min=0).sqrt(), contended)


def row_distance(left: Tensor, right: Tensor) -> Tensor:
    """Euclidean distances (N,) float64 of rows (N, D); terms are added in the order of the columns."""
    difference = left.double() - right.double()
    return (difference * difference).cumsum(dim=1)[:, -1].sqrt()


def _rounding_bound(query_square: Tensor, table_square: Tensor, width: int) -> Tensor:
    """Twice the largest rounding error of |a|^2 + |b|^2 - 2 a.b summed in any order over ``width`` + 2 terms."""
    a, b = query_square.amax(), table_square.amax()
    return 2 * (width + 4) * torch.finfo(query_square.dtype).eps * (a + b + 2 * (a * b).sqrt())


def _settle_second(tile: Tensor, place: Tensor, best: Tensor, tolerance: Tensor, second: Tensor) -> Tensor:
    """Write the second smallest of every row into ``second``; return (r,) bool where it is too close to tell."""
    tile.scatter_(1, place[:, None], float("inf"))
    torch.amin(tile, dim=1, out=second)
    tile.scatter_(1, place[:, None], best[:, None])
    return second - best <= tolerance


def _settle_ties(
    query: Tensor, table: Tensor, tile: Tensor, best: Tensor, tolerance: Tensor, close: Tensor, place: Tensor
) -> None:
    """Decide rows with several candidates within rounding by exact distances; writes into ``place``."""
    rows = close.nonzero()[:, 0]
    near, candidate = (tile[rows] <= (best[rows] + tolerance)[:, None]).nonzero().unbind(1)
    distance = row_distance(query[rows[near]], table[candidate])
    least = distance.new_full((len(rows),), float("inf")).scatter_reduce_(0, near, distance, "amin")
    winner = torch.where(distance == least[near], candidate, len(table))
    place[rows] = winner.new_full((len(rows),), len(table)).scatter_reduce_(0, near, winner, "amin")


def _exact_second(query: Tensor, table: Tensor, tile: Tensor, limit: Tensor, place: Tensor) -> Tensor:
    """(r,) float64 exact distance to the nearest row other than ``place``, infinity where there is none."""
    near, candidate = (tile <= limit[:, None]).nonzero().unbind(1)
    other = candidate != place[near]
    near, candidate = near[other], candidate[other]
    distance = row_distance(query[near], table[candidate])
    return distance.new_full((len(query),), float("inf")).scatter_reduce_(0, near, distance, "amin")
