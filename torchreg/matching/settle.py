"""Nearest rows decided beyond rounding: exact distances of all candidates that a float64 product cannot tell apart.

Scans of walls have thousands of nearly or exactly equal features. So the product is taken about the median of the
queries, where such a crowd is, and of a table sorted by distance from there: what is no farther than d from a query
lies between two spheres, hence in a slice. Equal rows are taken together. Ties go to the lower row.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from torchreg.matching.order import lexicographic, rank
from torchreg.matching.product import product

_TILE_ELEMENTS = 1 << 20  # 4 MB of float32: measured fastest on two cores, between 2^19 and 2^22
_ROWS = 128
_CANDIDATES = 1 << 18


def settle(query: Tensor, table: Tensor, count: int, bound: Tensor) -> tuple[Tensor, Tensor]:
    """The nearest rows of ``table`` (M, D) for every ``query`` (N, D), and how far they are.

    Args:
        query: (N, D).
        table: (M, D).
        count: how many of them.
        bound: (N,) float64; at least ``count`` rows are no farther than this.

    Returns:
        (N, count) int64 and (N, count) float64, ascending by (distance, row).
    """
    center = query.double().median(dim=0).values
    norm, outward = row_distance(query, center).sort()
    query, bound = query[outward], bound[outward]
    apart, listed = row_distance(table, center).sort(stable=True)
    table = table[listed]
    starts = torch.cat([listed.new_ones(1).bool(), (table[1:] != table[:-1]).any(dim=1)])  # of runs of equal rows
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
        near, exact, found = near[pair], exact[pair], listed[first[candidate[pair]] + rank(pair)]
        order = lexicographic(found, exact, near)
        near, exact, found = near[order], exact[order], found[order]
        place = rank(near)
        kept = place < count
        row[rows][near[kept], place[kept]] = found[kept]
        distance[rows][near[kept], place[kept]] = exact[kept]
    inward = outward.argsort()
    return row[inward], distance[inward]


def tile_rows(left: Tensor, right: Tensor) -> Iterator[tuple[slice, Tensor]]:
    """Yield slices of rows and their part of ``left`` @ ``right``, in one buffer that the next tile overwrites."""
    step = max(1, _TILE_ELEMENTS // right.shape[1])
    buffer = left.new_empty(min(step, len(left)), right.shape[1])
    for begin in range(0, len(left), step):
        rows = slice(begin, min(begin + step, len(left)))
        yield rows, torch.mm(left[rows], right, out=buffer[: rows.stop - begin])


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


def row_distance(left: Tensor, right: Tensor) -> Tensor:
    """Euclidean distances (N,) float64 of rows (N, D); terms are added in the order of the columns."""
    difference = left.double() - right.double()
    return (difference * difference).cumsum(dim=1)[:, -1].sqrt()


def pair_distance(left: Tensor, right: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """Exact distances (K,) float64 of rows ``left[i]`` and ``right[j]``, in pieces of bounded memory."""
    pieces = zip(i.split(_CANDIDATES), j.split(_CANDIDATES), strict=True)
    return torch.cat([row_distance(left.index_select(0, one), right.index_select(0, other)) for one, other in pieces])
