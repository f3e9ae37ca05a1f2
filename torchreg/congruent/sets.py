"""Congruent sets: two pairs of the target whose crossings meet and whose ends lie as those of a base do.

The smart index of Super4PCS (Mellado, Aiger and Mitra, Comput. Graph. Forum 33(5), 2014, doi:10.1111/cgf.12446): the
crossings of the pairs of one diagonal are put into cells, and those of the other look into the cells around their own.
Cells of all bases stand side by side, so one sort and one look-up serve them together. Two diagonals whose crossings
meet are congruent to the base where the four sides between their ends have its lengths too, which is the test of the
angle between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.congruent.bases import Bases
from torchreg.congruent.pairs import FoundPairs, runs
from torchreg.congruent.sides import CloudSide, dot
from torchreg.solvers.points import ranks

_MOST = 64  # cells along an axis
_CANDIDATES = 1 << 21  # pairs of crossings compared at once
_MOST_OF_BASE = 1 << 19  # of one base: of a plane, nearly all are congruent
_SIDES = ((0, 2), (0, 3), (1, 2), (1, 3))


class CongruentSets(NamedTuple):
    """S sets of four points of the target, corner by corner as their bases."""

    base: Tensor  # (S,) int64, which base
    corners: Tensor  # (4, S) int64, rows of the target


def congruent_sets(
    source: CloudSide, target: CloudSide, bases: Bases, pairs: tuple[FoundPairs, FoundPairs], tolerance: float
) -> Iterator[CongruentSets]:
    """Yield the sets of all bases, in parts; ``tolerance``, meters, is of lengths and between crossings."""
    one, other = (
        _crossings(target, found, ratio) for found, ratio in zip(pairs, bases.ratios, strict=True)
    )  # (3, F), (3, G)
    low = target.points.amin(dim=1)
    extent = float((target.points.amax(dim=1) - low).amax())
    width = max(tolerance, extent / _MOST)
    across = int(extent / width) + 3  # and an empty cell on either side
    number = bases.corners.shape[1]
    strides = (across * across, across, 1)
    volume = across**3
    cells = [
        found.base * volume + _cells(crossing, low, width, strides)
        for found, crossing in zip(pairs, (one, other), strict=True)
    ]
    order = cells[1].sort(stable=True).indices
    begins = torch.nn.functional.pad(torch.bincount(cells[1], minlength=number * volume).cumsum(0), (1, 0))
    around = [x * strides[0] + y * strides[1] for x, y in product((-1, 0, 1), repeat=2)]
    first = torch.stack([begins[cells[0] + step - 1] for step in around])  # (9, F)
    last = torch.stack([begins[cells[0] + step + 2] for step in around])
    kept = _within_limit((last - first).sum(dim=0), pairs[0].base, number)
    first, last, one = first[:, kept], last[:, kept], one[:, kept]
    mine_of = FoundPairs(*(part[kept] for part in pairs[0]))
    lengths = _side_lengths(source, bases.corners)  # (4, B)
    for rows in _by_work((last - first).sum(dim=0)):
        run, member = runs(first[:, rows].flatten(), last[:, rows].flatten())
        mine = run % (rows.stop - rows.start) + rows.start
        theirs = order[member]
        apart = one[:, mine] - other[:, theirs]
        near = (dot(apart, apart) <= tolerance * tolerance).nonzero()[:, 0]
        mine, theirs = mine[near], theirs[near]
        corners = torch.stack(
            [pairs[0].first[mine], pairs[0].second[mine], pairs[1].first[theirs], pairs[1].second[theirs]]
        )
        base = mine_of.base[mine]
        fit = ((_side_lengths(target, corners) - lengths[:, base]).abs().amax(dim=0) <= tolerance).nonzero()[:, 0]
        yield CongruentSets(base[fit], corners[:, fit])


def _crossings(target: CloudSide, found: FoundPairs, ratio: Tensor) -> Tensor:
    """(3, F), where the other diagonal crosses the pairs; ``ratio`` (B,) of every base."""
    begin, end = target.points[:, found.first], target.points[:, found.second]
    return begin + ratio[found.base] * (end - begin)


def _cells(points: Tensor, low: Tensor, width: float, strides: tuple[int, int, int]) -> Tensor:
    """The cells (F,) of points (3, F)."""
    place = torch.floor((points - low[:, None]) / width).clamp(min=0).long() + 1
    return place[0] * strides[0] + place[1] * strides[1] + place[2] * strides[2]


def _side_lengths(side: CloudSide, corners: Tensor) -> Tensor:
    """(4, S) of corners (4, S)."""
    points = side.points[:, corners]  # (3, 4, S)
    apart = torch.stack([points[:, a] - points[:, b] for a, b in _SIDES], dim=1)
    return dot(apart, apart).sqrt()


def _within_limit(work: Tensor, base: Tensor, number: int) -> Tensor:
    """Rows of pairs (F,) with this much work that are looked at: of bases that have too much, an even choice."""
    total = torch.zeros(number, dtype=torch.int64, device=work.device).index_add_(0, base, work)
    step = (total + _MOST_OF_BASE - 1).div(_MOST_OF_BASE, rounding_mode="floor").clamp(min=1)
    return (ranks(base) % step[base] == 0).nonzero()[:, 0]


def _by_work(work: Tensor) -> Iterator[slice]:
    """Slices of rows (F,) whose work together is at most ``_CANDIDATES``, or one row."""
    total = work.cumsum(0)
    begin, count, done = 0, len(work), 0
    while begin < count:
        limit = torch.tensor([done + _CANDIDATES], device=total.device)
        end = max(begin + 1, int(torch.searchsorted(total, limit, right=True)))
        yield slice(begin, end)
        begin, done = end, int(total[end - 1])
