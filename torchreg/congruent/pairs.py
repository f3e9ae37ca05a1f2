"""Pairs of points of the target by their distance, and those that agree with the diagonals of bases.

The pairs of a cloud are sorted by distance once; a diagonal then takes one run of them. What two oriented points have
besides their distance, the angles of both normals with the line between them and with each other, filters the run, and
so do colors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.congruent.bases import Bases
from torchreg.congruent.sides import CloudSide, Tolerances, dot, unit
from torchreg.geometry.numerics.chunks import row_chunks

_ELEMENTS = 1 << 20
_THINNED = 64  # of the table, of which every so many-th row is read for an estimate


class PairTable(NamedTuple):
    """The pairs of points of one cloud, K in all, ascending by distance."""

    length: Tensor  # (K,) float32, meters
    first: Tensor  # (K,) int32, rows of the cloud
    second: Tensor  # (K,) int32
    angles: Tensor | None  # (3, K) float32, cosines: of both normals with the way from the first, of each other


class FoundPairs(NamedTuple):
    """Pairs that agree with a diagonal of some bases, F in all."""

    base: Tensor  # (F,) int64, which base
    first: Tensor  # (F,) int64, rows of the target
    second: Tensor  # (F,) int64


def pair_table(side: CloudSide, shortest: float, longest: float) -> PairTable:
    """The pairs whose distance is in [``shortest``, ``longest``], meters."""
    points, number = side.points, side.points.shape[1]
    rows_of, lengths = [], []
    column = torch.arange(number, device=points.device)
    for rows in row_chunks(number, number, _ELEMENTS):
        apart = points[:, rows, None] - points[:, None]
        square = dot(apart, apart)
        inside = (square >= shortest * shortest) & (square <= longest * longest)
        kept = (inside & (column > column[rows, None])).flatten().nonzero()[:, 0]
        rows_of.append(kept + rows.start * number)
        lengths.append(square.flatten()[kept].sqrt())
    number_of, length = torch.cat(rows_of), torch.cat(lengths)
    length, order = length.sort(stable=True)
    number_of = number_of[order]
    first, second = number_of // number, number_of % number
    return PairTable(length, first.int(), second.int(), _angles(side, first, second))


def found_pairs(
    table: PairTable, source: CloudSide, target: CloudSide, bases: Bases, diagonal: int, within: Tolerances
) -> FoundPairs:
    """The pairs of the target, in either direction, that agree with a diagonal (0 or 1) of every base."""
    a, b = bases.corners[2 * diagonal : 2 * diagonal + 2]  # (B,)
    apart = source.points[:, b] - source.points[:, a]
    length = dot(apart, apart).sqrt()
    low = torch.searchsorted(table.length, length - within.meters).tolist()
    high = torch.searchsorted(table.length, length + within.meters, right=True).tolist()
    angles = _angles(source, a, b)
    wanted: list[list[float]] = [[]] * len(low) if angles is None else angles.t().tolist()
    # a run is read where it stands, base by base: to gather the runs of all bases takes many times longer
    parts = [
        (torch.full_like(rows, number), first[rows].long(), second[rows].long())
        for number, (begin, end) in enumerate(zip(low, high, strict=True))
        for rows, first, second in _agreeing(table, begin, max(begin, end), wanted[number], within)
    ]
    none = torch.zeros(0, dtype=torch.int64, device=table.length.device)
    base, first, second = (torch.cat(part) for part in zip((none, none, none), *parts, strict=True))
    if source.colors is not None and target.colors is not None and within.colors < math.inf:
        same = [
            _distance(source.colors[:, ends[base]], target.colors[:, found]) <= within.colors
            for ends, found in ((a, first), (b, second))
        ]
        kept = (same[0] & same[1]).nonzero()[:, 0]
        base, first, second = base[kept], first[kept], second[kept]
    return FoundPairs(base, first, second)


def rarest(
    table: PairTable, source: CloudSide, target: CloudSide, bases: Bases, within: Tolerances, count: int
) -> Bases:
    """The ``count`` bases that the fewest pairs agree with, rarest first, by an even choice of the table.

    The work for a base, and the poses that it proposes by chance, grow with the product of both diagonals' pairs.
    """
    rows = slice(None, None, _THINNED)
    angles = None if table.angles is None else table.angles[:, rows].contiguous()
    thin = PairTable(table.length[rows].contiguous(), table.first[rows], table.second[rows], angles)
    numbers = [
        torch.bincount(found_pairs(thin, source, target, bases, k, within).base, minlength=bases.corners.shape[1]) + 1
        for k in range(2)
    ]
    return bases.take((numbers[0] * numbers[1]).sort(stable=True).indices[:count])


def runs(low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Of runs ``low[i]:high[i]`` (R,) all members: numbers i of their runs, and the members, run by run."""
    counts = (high - low).clamp(min=0)
    run = torch.arange(len(low), device=low.device).repeat_interleave(counts)
    begin = counts.cumsum(0) - counts
    return run, torch.arange(len(run), device=low.device) - begin[run] + low[run]


def _angles(side: CloudSide, first: Tensor, second: Tensor) -> Tensor | None:
    """(3, K) of pairs of rows (K,)."""
    if side.normals is None:
        return None
    parts = []
    for rows in row_chunks(len(first), 16, _ELEMENTS):
        i, j = first[rows], second[rows]
        way = unit(side.points[:, j] - side.points[:, i])
        n, m = side.normals[:, i], side.normals[:, j]
        parts.append(torch.stack([dot(n, way), dot(m, way), dot(n, m)]))
    return torch.cat(parts, dim=1) if parts else side.points[:, :0]


def _agreeing(
    table: PairTable, begin: int, end: int, wanted: Sequence[float], within: Tolerances
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Yield rows of the table in ``begin:end`` whose angles are as wanted, and its first and second ends.

    First those that agree as they stand, then those that agree when turned round, their ends exchanged.
    """
    if table.angles is None or within.normals >= math.pi:
        every = torch.arange(begin, end, device=table.length.device)
        yield every, table.first, table.second
        yield every, table.second, table.first
        return
    of_one, of_two = _slack(within.normals), _slack(2 * within.normals)  # one normal is off, or both are

    def near(values: Tensor, cosine: float, slack: float) -> Tensor:
        if not within.signed:
            values, cosine = values.abs(), abs(cosine)
        return (values - cosine).abs_() <= slack

    first, second, both = wanted
    rows = near(table.angles[2, begin:end], both, of_two).nonzero()[:, 0] + begin
    one, other = table.angles[0][rows], table.angles[1][rows]
    as_they_stand = near(one, first, of_one) & near(other, second, of_one)
    yield rows[as_they_stand.nonzero()[:, 0]], table.first, table.second
    turned_round = near(one, -second, of_one) & near(other, -first, of_one)
    yield rows[turned_round.nonzero()[:, 0]], table.second, table.first


def _slack(radians: float) -> float:
    """By how much the cosines of two angles differ at most that differ by ``radians``."""
    return 2 * math.sin(min(radians, math.pi) / 2)


def _distance(one: Tensor, other: Tensor) -> Tensor:
    """Of columns (3, F)."""
    apart = one - other
    return dot(apart, apart).sqrt()
