"""Which of the nearest are mutual, as far as one pass of the product tells.

A pair (i, j) is mutual when fewer than K queries are nearer to j than i is. Those that list j among their own
nearest are known with their exact distances; of all others the least entries of column j are at hand. A pair is open
where these lie within the bound on rounding, or are too few to rule it out; a search back then decides.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.matching.nearest import FeatureNearest
from torchreg.matching.order import lexicographic, rank


class CandidatePairs(NamedTuple):
    """Pairs of a query and one of its nearest.

    Attributes:
        source, target: (C,) int64, rows of the query and of the table.
        distance: (C,) float64.
        stands: (C,) bool, certainly mutual.
        open: (C,) bool, not known; what neither stands nor is open is certainly not mutual.
    """

    source: Tensor
    target: Tensor
    distance: Tensor
    stands: Tensor
    open: Tensor


def candidate_pairs(forth: FeatureNearest, neighbors: int) -> CandidatePairs:
    """Judge the pairs of every query with its ``neighbors`` nearest; ``forth`` may list more of them."""
    i = torch.arange(len(forth.row), device=forth.row.device)[:, None].expand_as(forth.row)  # (N, K)
    listed = _listed_before(i.flatten(), forth.row.flatten(), forth.distance.flatten(), forth.listed)
    i, j, distance = (item[:, :neighbors].flatten() for item in (i, forth.row, forth.distance))  # (C,)
    factors, others = forth.factors, forth.others[:, j].double()  # (K, C)
    scaled, norm, longest = distance / factors.scale, factors.right_norm[j], factors.left_norm.amax()
    nearer = others + factors.error(norm, factors.reach(norm, others, longest)) < scaled.square()
    count = nearer.sum(dim=0) + listed.view_as(forth.row)[:, :neighbors].flatten()
    possible = count < neighbors
    alone = forth.listed[i] & (others[0] > scaled.square() + factors.error(norm, scaled))
    return CandidatePairs(i, j, distance, possible & alone, possible & ~alone)


def _listed_before(i: Tensor, j: Tensor, distance: Tensor, listed: Tensor) -> Tensor:
    """How many pairs of listed queries have the same j and a lesser (distance, i); (C,) int64. ``i`` ascends."""
    order = lexicographic(distance, j)
    counts = listed[i[order]].long()
    before = counts.cumsum(0) - counts  # over all j
    begin = torch.arange(len(j), device=j.device) - rank(j[order])
    return torch.empty_like(j).scatter_(0, order, before - before[begin])
