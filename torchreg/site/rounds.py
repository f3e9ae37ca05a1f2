"""Which pairs of scans are registered: all of a small site; of a large one those that promise most, in rounds.

    first      every scan with those that its sketch agrees with most, beyond chance; then, round after round:
    loose      scans that are not placed, and groups apart, with the next best
    threads    both sides of a pair of scans that alone holds two parts together, with the next best across it
    near       scans that overlap under the poses found, where a scan was tried with few such yet

Every pair is registered without a guess, those that the poses suggest too: so what it says is evidence for or against
the poses, never their echo.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.site.bridges import bridges
from torchreg.site.pairs import ALL_SCANS
from torchreg.site.sketches import Sketch

_SHARE = 0.2  # of the pairs of a larger site, at most
_FIRST = 8  # partners of every scan
_MORE = 6  # in a later round, of a scan or a part that is loose
_PARTNERS = 5  # that overlap with it, every scan should have been tried with
_OVERLAP = 0.25  # of one of both sketches, for scans to count as overlapping
_CELL = 3.0  # spacings of the points of a sketch: edge of the cells in which sketches meet
_CELLS_AT_ONCE = 1 << 14

Pair = tuple[int, int]
"""Of places among the usable scans, ascending."""


def most_pairs(count: int) -> int:
    """How many pairs of ``count`` usable scans may be registered."""
    few = min(count, ALL_SCANS)
    return max(few * (few - 1) // 2, int(_SHARE * count * (count - 1) / 2))


class Standing(NamedTuple):
    """What is known after a round, of U usable scans in their order.

    Attributes:
        group: (U,) int64, the group of each; -1 where not placed.
        T_world_scan: (U, 4, 4) float64; NaN where not placed.
        tried: the pairs that were registered.
        holding: of these the pairs whose links hold the poses.
    """

    group: Tensor
    T_world_scan: Tensor
    tried: frozenset[Pair]
    holding: frozenset[Pair]


def first_pairs(votes: Tensor) -> list[Pair]:
    """Every scan with the ``_FIRST`` that have most votes with it, those of most first.

    ``votes`` (U, U) float64 is symmetric.
    """
    everyone = torch.ones_like(votes, dtype=torch.bool)
    chosen = {pair for scan in range(len(votes)) for pair in _best(votes, _row(everyone, scan), _FIRST)}
    return sorted(chosen, key=lambda pair: (-float(votes[pair]), pair))


def next_pairs(votes: Tensor, sketches: Sequence[Sketch], standing: Standing) -> list[Pair]:
    """The pairs to be registered next, the most wanted ones first; none that were tried."""
    untried = torch.ones_like(votes, dtype=torch.bool)
    for a, b in standing.tried:
        untried[a, b] = untried[b, a] = False
    wanted = dict.fromkeys(_loose(votes, untried, standing))
    wanted |= dict.fromkeys(_threads(votes, untried, standing))
    wanted |= dict.fromkeys(_near(overlaps(sketches, standing), untried))
    return list(wanted)


def overlaps(sketches: Sequence[Sketch], standing: Standing) -> Tensor:
    """The greater share (U, U) float64 of both sketches that lies in cells of the other's; 0 between groups."""
    result = torch.zeros(len(sketches), len(sketches), dtype=torch.float64)
    for group in range(int(standing.group.max()) + 1 if len(sketches) else 0):
        members = (standing.group == group).nonzero()[:, 0]
        placed = [_moved(sketches[scan].points, standing.T_world_scan[scan]) for scan in members.tolist()]
        edge = _CELL * float(torch.tensor([sketches[scan].spacing for scan in members.tolist()]).median())
        scan = torch.arange(len(placed)).repeat_interleave(torch.tensor([len(points) for points in placed]))
        cells = torch.cat(placed).div(edge).floor().long()
        cell = torch.unique(cells - cells.amin(dim=0), dim=0, return_inverse=True)[1]
        both = torch.zeros(len(placed), len(placed), dtype=torch.float64)
        for begin in range(0, int(cell.max()) + 1, _CELLS_AT_ONCE):
            here = (cell >= begin) & (cell < begin + _CELLS_AT_ONCE)
            held = torch.zeros(len(placed), _CELLS_AT_ONCE)
            held[scan[here], cell[here] - begin] = 1.0
            both += (held @ held.t()).double()  # whole numbers: exact in any order
        own = both.diagonal()
        result[members[:, None], members] = both / torch.minimum(own[:, None], own)
    return result.fill_diagonal_(0.0)


def _loose(votes: Tensor, untried: Tensor, standing: Standing) -> Iterable[Pair]:
    """Scans without a group, and groups but the largest, with others that have most votes with them."""
    for scan in (standing.group < 0).nonzero()[:, 0].tolist():
        yield from _best(votes, _row(untried, scan), _MORE)
    for group in range(1, int(standing.group.max()) + 1):
        inside = standing.group == group
        yield from _best(votes, untried & inside[:, None] & ~inside & (standing.group >= 0), _MORE)


def _threads(votes: Tensor, untried: Tensor, standing: Standing) -> Iterable[Pair]:
    """Across every pair of scans without which a group would fall apart, those that have most votes."""
    for bridge in bridges(sorted(standing.holding), len(votes)):
        inside = torch.zeros(len(votes), dtype=torch.bool)
        inside[list(bridge.smaller)] = True
        group = standing.group[min(bridge.smaller)]
        yield from _best(votes, untried & inside[:, None] & (~inside & (standing.group == group)), _MORE)


def _near(overlap: Tensor, untried: Tensor) -> Iterable[Pair]:
    """Scans tried with fewer than ``_PARTNERS`` that overlap them, with those that overlap them most."""
    near = overlap >= _OVERLAP
    for scan in range(len(overlap)):
        missing = _PARTNERS - int((near[scan] & ~untried[scan]).sum())
        if missing > 0:
            yield from _best(overlap, _row(untried & near, scan), missing)


def _best(value: Tensor, allowed: Tensor, count: int) -> list[Pair]:
    """The ``count`` pairs of the greatest value among those allowed, (U, U) each; the lower numbers where equal."""
    upper = (allowed | allowed.t()).triu(diagonal=1)
    a, b = upper.nonzero(as_tuple=True)
    order = value[a, b].argsort(descending=True, stable=True)[:count]
    return list(zip(a[order].tolist(), b[order].tolist(), strict=True))


def _row(allowed: Tensor, scan: int) -> Tensor:
    """The same, for the pairs of one scan alone."""
    mine = torch.zeros_like(allowed)
    mine[scan] = allowed[scan]
    return mine


def _moved(points: Tensor, T: Tensor) -> Tensor:
    return apply_rotation(T[:3, :3], points) + T[:3, 3]
