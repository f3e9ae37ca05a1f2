"""Nearest rows decided beyond rounding: exact distances of all candidates that a float64 product cannot tell apart.

Scans of walls have thousands of nearly or exactly equal features. Equal rows are therefore taken together first,
and the candidates of the rest are those within the rounding of a float64 product, which is rarely more than one.
Ties go to the lower row.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

_TILE_ELEMENTS = 1 << 20  # 4 MB of float32: measured fastest on two cores, between 2^19 and 2^22
_CANDIDATES = 1 << 18


class Settled(NamedTuple):
    """Exact answers.

    Attributes:
        row: (N,) int64, the nearest row, the lowest of several.
        second: (N,) float64, distance to the nearest other row; infinity where there is none.
    """

    row: Tensor
    second: Tensor


def settle(query: Tensor, table: Tensor) -> Settled:
    """The nearest and the distance of the second nearest row of ``table`` (M, D) for every ``query`` (N, D)."""
    query, back = query.unique(dim=0, return_inverse=True)
    distinct, number, count = table.unique(dim=0, return_inverse=True, return_counts=True)
    places = torch.arange(len(table), device=table.device)
    first = torch.full_like(count, len(table)).scatter_reduce_(0, number, places, "amin")
    left, right = augmented(query.double(), distinct.double())
    tolerance = rounding_bound(query.double(), distinct.double())
    row = torch.empty(len(query), dtype=torch.int64, device=query.device)
    second = torch.empty(len(query), dtype=torch.float64, device=query.device)
    for rows, tile in tile_rows(left, right):
        best, place = tile.min(dim=1)
        limit = best if len(distinct) == 1 else tile.scatter_(1, place[:, None], float("inf")).amin(dim=1)
        tile.scatter_(1, place[:, None], best[:, None])
        near, candidate = (tile <= (limit + tolerance)[:, None]).nonzero().unbind(1)
        distance = _distances(query[rows], distinct, near, candidate)
        least = distance.new_full((tile.shape[0],), float("inf")).scatter_reduce_(0, near, distance, "amin")
        winner = torch.where(distance == least[near], first[candidate], len(table))
        row[rows] = torch.full_like(row[rows], len(table)).scatter_reduce_(0, near, winner, "amin")
        # the winner itself is no second, unless the table holds it twice
        alone = (first[candidate] == row[rows][near]) & (count[candidate] == 1)
        others = distance.masked_fill(alone, float("inf"))
        second[rows] = torch.full_like(least, float("inf")).scatter_reduce_(0, near, others, "amin")
    return Settled(row[back], second[back])


def row_distance(left: Tensor, right: Tensor) -> Tensor:
    """Euclidean distances (N,) float64 of rows (N, D); terms are added in the order of the columns."""
    difference = left.double() - right.double()
    return (difference * difference).cumsum(dim=1)[:, -1].sqrt()


def augmented(query: Tensor, table: Tensor) -> tuple[Tensor, Tensor]:
    """Factors (N, D + 2) and (D + 2, M) whose product is |a|^2 + |b|^2 - 2 a.b."""
    a, b = (query * query).sum(dim=1, keepdim=True), (table * table).sum(dim=1, keepdim=True)
    left = torch.cat([query, torch.ones_like(a), a], dim=1)
    right = torch.cat([-2 * table, b, torch.ones_like(b)], dim=1)
    return left, right.t().contiguous()


def rounding_bound(query: Tensor, table: Tensor) -> Tensor:
    """Twice the largest rounding error of that product, its D + 2 terms summed in any order."""
    a, b = (query * query).sum(dim=1).amax(), (table * table).sum(dim=1).amax()
    return 2 * (query.shape[1] + 4) * torch.finfo(query.dtype).eps * (a + b + 2 * (a * b).sqrt())


def tile_rows(left: Tensor, right: Tensor) -> Iterator[tuple[slice, Tensor]]:
    """Yield slices of rows and their part of ``left`` @ ``right``, in one buffer that the next tile overwrites."""
    step = max(1, _TILE_ELEMENTS // right.shape[1])
    buffer = left.new_empty(min(step, len(left)), right.shape[1])
    for begin in range(0, len(left), step):
        rows = slice(begin, min(begin + step, len(left)))
        yield rows, torch.mm(left[rows], right, out=buffer[: rows.stop - begin])


def _distances(query: Tensor, table: Tensor, near: Tensor, candidate: Tensor) -> Tensor:
    """Exact distances of pairs of rows, in pieces of bounded memory."""
    pieces = zip(near.split(_CANDIDATES), candidate.split(_CANDIDATES), strict=True)
    return torch.cat([row_distance(query[i], table[j]) for i, j in pieces])
