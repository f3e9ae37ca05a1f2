"""Mutual nearest neighbors in feature space (the paper, section 4.1).

A pair (i, j) is mutual when fewer than K queries are nearer to j than i is. The exact distances of queries that have j
among their nearest are computed already; of all others the least entries of column j are. A pair is undecided where
these lie within the bound on rounding, or are too few to rule it out; a search from j to the queries then decides.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import at_least, expect, fraction
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.matching.nearest import FeatureNearest, feature_nearest, lexicographic, rank
from torchreg.matching.shadows import compiled, shadowed, shadows_nearest
from torchreg.types import Correspondences, Features
from torchreg.types.packing import offsets_of, spans


@entry
def match_mutual(
    source: Features, target: Features, *, ratio: float | None = None, neighbors: int = 1
) -> Correspondences:
    """Pairs of points each of which is among the other's nearest in feature space.

    Args:
        source: features of B clouds, finite where valid.
        target: the same, of the same width.
        ratio: keep a match only when its distance is below this fraction of the distance to the second
            nearest target (Lowe, IJCV 60(2), 2004, doi:10.1023/B:VISI.0000029664.99615.94); ``None``: keep all.
        neighbors: (i, j) is a match when j is among the ``neighbors`` nearest targets of i, and i among the
            ``neighbors`` nearest sources of j. Above 1 a point may have several matches.

    Returns:
        Correspondences, ascending by source row, then by target row; ``score`` is the feature distance. Exact, as a
        brute-force search in float64, ties to the lower row; the same for any batch and number of threads. Rows that
        are not valid are never matched. No gradients.

    Raises:
        ValueError: different numbers of clouds, widths or dtypes, a ratio outside (0, 1], ``neighbors`` below 1, or
            a ratio and ``neighbors`` above 1: a second nearest that is as good would be another match.

    Example:
        >>> import torch, torchreg as tr
        >>> rows = tr.Features(torch.eye(3), torch.tensor([0, 3]), (("any", 3),), torch.tensor([True, True, True]))
        >>> tr.match_mutual(rows, rows).target
        tensor([0, 1, 2])
    """
    expect_comparable(source, target)
    at_least(neighbors, "neighbors", 1)
    if ratio is not None:
        fraction(ratio, "ratio")
        expect(neighbors == 1, "neighbors", "1 beside a ratio", neighbors)
    with undisturbed(source.values):
        parts = [
            _match_pair(source, target, i, k, ratio, neighbors)
            for i, k in zip(spans(source.offsets), spans(target.offsets), strict=True)
        ]
    empty = torch.zeros(0, dtype=torch.int64, device=source.values.device)
    return Correspondences(
        source=torch.cat([empty, *(part[0] for part in parts)]),
        target=torch.cat([empty, *(part[1] for part in parts)]),
        offsets=offsets_of(len(part[0]) for part in parts),
        score=torch.cat([source.values.new_zeros(0), *(part[2] for part in parts)]),
    )


def expect_comparable(source: Features, target: Features) -> None:
    """Raise ``ValueError`` where the numbers of clouds, the widths or the dtypes of two sides differ."""
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    expect(
        source.values.shape[1] == target.values.shape[1] and source.values.dtype == target.values.dtype,
        "target",
        f"features of width {source.values.shape[1]}, {source.values.dtype}",
        target.values,
    )


def _match_pair(
    source: Features,
    target: Features,
    source_rows: tuple[int, int],
    target_rows: tuple[int, int],
    ratio: float | None,
    neighbors: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Global source rows, global target rows and feature distances of one pair."""
    of_source, of_target = _usable(source, *source_rows), _usable(target, *target_rows)
    left, right = source.values.index_select(0, of_source), target.values.index_select(0, of_target)
    if len(left) == 0 or len(right) == 0:
        return of_source[:0], of_target[:0], left.new_zeros(0)
    judge = _by_shadows if compiled(left, right) else _by_products
    i, j, distance = judge(left, right, ratio, neighbors)
    order = lexicographic(j, i)
    i, j = i[order], j[order]
    return of_source[i], of_target[j], distance[order].to(left.dtype)


def _by_products(left: Tensor, right: Tensor, ratio: float | None, neighbors: int) -> tuple[Tensor, Tensor, Tensor]:
    """Rows of mutual pairs and their distances, in any order; the product forth decides most of them."""
    forth = feature_nearest(left, right, neighbors if ratio is None else 2)
    pairs = candidate_pairs(forth, neighbors)
    mutual, undecided = pairs.mutual, pairs.undecided
    if ratio is not None and len(right) > 1:
        passes = forth.distance[:, 0] < ratio * forth.distance[:, 1]
        mutual, undecided = mutual & passes, undecided & passes
    doubtful = undecided.nonzero()[:, 0]
    if len(doubtful) > 0:
        # back from the targets of those pairs alone
        wanted, number = pairs.target[doubtful].unique(return_inverse=True)
        back = feature_nearest(right[wanted], left, neighbors).row[number]
        mutual[doubtful] = (back == pairs.source[doubtful, None]).any(dim=1)
    return pairs.source[mutual], pairs.target[mutual], pairs.distance[mutual]


def _by_shadows(left: Tensor, right: Tensor, ratio: float | None, neighbors: int) -> tuple[Tensor, Tensor, Tensor]:
    """The same by compiled kernels: back from every target that was found, no farther than it was found from."""
    both = shadowed(left, right)
    row, distance = shadows_nearest(both.source, both.target, both, neighbors if ratio is None else 2)
    if ratio is not None and row.shape[1] > 1:
        i = (distance[:, 0] < ratio * distance[:, 1]).nonzero()[:, 0]
        j, distance = row[i, 0], distance[i, 0]
    else:
        i = torch.arange(len(row))[:, None].expand_as(row).flatten()
        j, distance = row.flatten(), distance.flatten()
    if len(i) == 0:
        return i, j, distance
    order = lexicographic(distance, j)
    i, j, distance = i[order], j[order], distance[order]
    place = rank(j)
    first, last = place == 0, place == neighbors - 1
    number = first.cumsum(0) - 1
    bound = distance.new_full((int(number[-1]) + 1,), float("inf")).scatter_(0, number[last], distance[last])
    back, _ = shadows_nearest(both.target.at(j[first]), both.source, both, neighbors, bound)
    mutual = (back[number] == i[:, None]).any(dim=1)
    return i[mutual], j[mutual], distance[mutual]


def _usable(features: Features, begin: int, end: int) -> Tensor:
    return begin + features.valid[begin:end].nonzero()[:, 0]


class CandidatePairs(NamedTuple):
    """Pairs of a query and one of its nearest."""

    source: Tensor  # (C,) int64, rows of the query and of the table
    target: Tensor  # (C,) int64, rows of the query and of the table
    distance: Tensor  # (C,) float64
    mutual: Tensor  # (C,) bool, certainly mutual
    undecided: Tensor  # (C,) bool, may be mutual; a pair that is neither is certainly not


def candidate_pairs(forth: FeatureNearest, neighbors: int) -> CandidatePairs:
    """Judge the pairs of every query with its ``neighbors`` nearest; ``forth`` may list more of them."""
    i = torch.arange(len(forth.row), device=forth.row.device)[:, None].expand_as(forth.row)  # (N, K)
    before = _clear_before(i.flatten(), forth.row.flatten(), forth.distance.flatten(), forth.clear)
    i, j, distance = (item[:, :neighbors].flatten() for item in (i, forth.row, forth.distance))  # (C,)
    factors, others = forth.factors, forth.others[:, j].double()  # (K, C)
    scaled, norm, longest = distance / factors.scale, factors.right_norm[j], factors.left_norm.amax()
    nearer = others + factors.error(norm, factors.reach(norm, others, longest)) < scaled.square()
    count = nearer.sum(dim=0) + before.view_as(forth.row)[:, :neighbors].flatten()
    possible = count < neighbors
    alone = forth.clear[i] & (others[0] > scaled.square() + factors.error(norm, scaled))
    return CandidatePairs(i, j, distance, possible & alone, possible & ~alone)


def _clear_before(i: Tensor, j: Tensor, distance: Tensor, clear: Tensor) -> Tensor:
    """How many pairs of clear queries have the same j and a lesser (distance, i); (C,) int64. ``i`` ascends."""
    order = lexicographic(distance, j)
    counts = clear[i[order]].long()
    before = counts.cumsum(0) - counts  # over all j
    begin = torch.arange(len(j), device=j.device) - rank(j[order])
    return torch.empty_like(j).scatter_(0, order, before - before[begin])
