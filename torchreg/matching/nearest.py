"""Exact nearest neighbors in feature space, from tiles of a matrix product.

The product is rounded in a way that depends on the shape of the tile and the number of threads. So it only proposes:
a few more candidates than asked for, of which distances in float64, computed elementwise from the features as they
came, decide. Rows that have still more candidates within the bound on the rounding go to ``settle``. The answer is
therefore the same for any tile and any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.matching.product import Product, least, product
from torchreg.matching.settle import pair_distance, settle, tile_rows

_MORE = 2  # candidates beyond those asked for


class FeatureNearest(NamedTuple):
    """The nearest rows of the other set for every row.

    Attributes:
        row: (N, K) int64, ascending by (distance, row).
        distance: (N, K) float64, Euclidean.
        listed: (N,) bool; where true, ``others`` leaves the row's own nearest out.
        others: (K, M) entries of the product, per row of the table the least over the queries but for those
            whose nearest include it: at most one of a tile, ascending; infinity where there are fewer.
        factors: the product.
    """

    row: Tensor
    distance: Tensor
    listed: Tensor
    others: Tensor
    factors: Product


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
    for rows, tile in tile_rows(factors.left, factors.right):
        value[rows], row[rows] = least(tile, factors.width, several)
        last, norm = value[rows, count - 1].double(), factors.left_norm[rows]
        limit[rows] = last + 2 * factors.error(norm, factors.reach(norm, last, longest))
        clear = _clear(value[rows], limit[rows], count)[:, None]
        tile.scatter_(1, row[rows, :count], value[rows, :count].masked_fill(clear, float("inf")))
        _merge(others, tile.amin(dim=0)[: len(table)])
    listed = _clear(value, limit, count)
    row, distance = _decide(query, table, row, value <= limit[:, None], count)
    if several < len(table):
        open_ = (value[:, -1] <= limit).nonzero()[:, 0]
        if len(open_) > 0:
            row[open_], distance[open_] = settle(query[open_], table, count, distance[open_, -1])
    return FeatureNearest(row, distance, listed, others, factors)


def _clear(value: Tensor, limit: Tensor, count: int) -> Tensor:
    """Rows (N,) whose ``count`` nearest the product tells from all others."""
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
