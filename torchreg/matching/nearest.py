"""Exact nearest neighbors in feature space, from tiles of a matrix product.

The product gives |a|^2 + |b|^2 - 2 a.b for a tile of rows against all of the other set, up to rounding that depends
on the shape of the tile and the number of threads. So it only proposes: rows where a second candidate lies within
the bound on that rounding are decided by ``settle``. The answer is therefore the same for any tile and any number
of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.matching.settle import augmented, rounding_bound, row_distance, settle, tile_rows


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
    left, right = augmented(query, table)
    tolerance = rounding_bound(query, table)
    row = torch.empty(len(query), dtype=torch.int64, device=query.device)
    least, second = torch.empty_like(query[:, 0]), torch.empty_like(query[:, 0])
    column = torch.full_like(table[:, 0], float("inf"))
    for rows, tile in tile_rows(left, right):
        torch.minimum(column, tile.amin(dim=0), out=column)
        least[rows], row[rows] = tile.min(dim=1)
        tile.scatter_(1, row[rows, None], float("inf"))
        torch.amin(tile, dim=1, out=second[rows])
    apart = second.double().clamp(min=0).sqrt()
    if exact_second:
        row, apart = settle(query, table)
    else:
        close = (second - least <= tolerance).nonzero()[:, 0]
        if len(close) > 0:
            row[close] = settle(query[close], table).row
    contended = least <= column[row] + 2 * tolerance
    return FeatureNearest(row, row_distance(query, table[row]), apart, contended)
