"""How far the matches support a pose: the probability that chance alone brings as many agreements.

Matches within the threshold are counted and compared with the count of unrelated matches under the same pose: each
source point paired with the target points of other matches. Points that lie close together share their neighborhoods
and so their features, and their matches agree or fail together. So places are counted, not matches:
the source is cut into cells about as wide as a feature's support, and every cell counts by the share of its matches
that agree.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather_columns
from torchreg.native import call, native
from torchreg.solvers.chance import log10_binomial_tail
from torchreg.verification.candidates import joined

_REPAIRINGS = 16
_MOST = 400.0  # powers of ten: beyond it nothing differs, and numbers stay finite
_ELEMENTS = 1 << 17  # pairings moved at once: what is made of them stays in the cache
_CELL = 3.5  # thresholds: 5 spacings, the support radius of a feature by default


class MatchEndpoints(NamedTuple):
    """The points that the matches of one proposal join: source and target (M, 3), meters, float64."""

    source: Tensor
    target: Tensor
    coarser: float = 1.0  # how many times as far apart the points were that were matched


class MatchCells(NamedTuple):
    """The matches of one proposal in cells of their source points, with other pairings of the same points."""

    source: Tensor  # (3, M) meters, cell by cell
    targets: Tensor  # (3, 17, M) the target points that are matched to them, then those of 16 other pairings
    last: Tensor  # (C,) int64, the last match of every cell
    size: Tensor  # (C,) int64, matches in every cell
    threshold: float  # meters, within which a match agrees


class Agreement(NamedTuple):
    """Of H poses."""

    support: Tensor  # (H,) int64, matches within the threshold
    # (H,) float64, -log10 of the probability that unrelated matches agree in as many places; at least 0
    surprise: Tensor


def match_cells(matches: MatchEndpoints, threshold: float) -> MatchCells:
    """Put the matches of one proposal in cells and pair them anew; ``threshold``, meters, is the pair's."""
    threshold = threshold * matches.coarser
    count, device = len(matches.source), matches.source.device
    if count == 0:
        none = torch.zeros(0, dtype=torch.int64, device=device)
        source, target = matches.source.t(), matches.target.t()
        return MatchCells(source, target[:, None].expand(3, 1 + _REPAIRINGS, 0), none, none, threshold)
    source, target = matches.source.t().contiguous(), matches.target.t().contiguous()
    corner = torch.floor((source - source.amin(dim=1, keepdim=True)) / (_CELL * threshold))
    order = torch.arange(count, device=device)
    for axis in (2, 1, 0):
        order = order[corner[axis, order].sort(stable=True).indices]
    corner = corner[:, order]
    ends = torch.nn.functional.pad((corner[:, 1:] != corner[:, :-1]).any(dim=0), (0, 1), value=True)
    last = ends.nonzero()[:, 0]
    size = torch.nn.functional.pad(last, (1, 0), value=-1).diff()
    steps = [0, *(1 + (k * (count - 1)) // (_REPAIRINGS + 1) for k in range(1, _REPAIRINGS + 1))]
    rows = (order - torch.tensor(steps, device=device)[:, None]) % count  # (17, M)
    return MatchCells(source[:, order].contiguous(), gather_columns(target, rows), last, size, threshold)


def agreement(cells: MatchCells, rotation: Tensor, translation: Tensor) -> Agreement:
    """Weigh poses (H, 3, 3), (H, 3) on matches."""
    count = cells.source.shape[1]
    if count == 0 or len(rotation) == 0:
        empty = torch.zeros(len(rotation), dtype=torch.float64, device=rotation.device)
        return Agreement(empty.long(), empty)
    support, agreeing, chance = _counted(cells, rotation, translation)
    number = len(cells.size)
    surprises = [
        min(_MOST, 0.0 - log10_binomial_tail(number, int(here), max(1.0 / _REPAIRINGS, expected) / number))
        for here, expected in zip(agreeing.tolist(), (chance / _REPAIRINGS).tolist(), strict=True)
    ]
    return Agreement(support, torch.tensor(surprises, dtype=torch.float64, device=rotation.device))


class _Counted(NamedTuple):
    """Of H poses; sums over cells are of the shares of their matches that agree."""

    support: Tensor  # (H,) int64, matches within the threshold
    agreeing: Tensor  # (H,) float64, the sum over cells
    chance: Tensor  # (H,) float64, the sum over cells of all other pairings together


def _counted(cells: MatchCells, rotation: Tensor, translation: Tensor) -> _Counted:
    if native(*cells[:4], rotation, translation) and rotation.dtype == cells.source.dtype == torch.float64:
        return _counted_compiled(cells, rotation.detach().contiguous(), translation.detach().contiguous())
    parts = [
        _counted_of_few(cells, rotation[rows], translation[rows])
        for rows in row_chunks(len(rotation), cells.targets[0].numel(), _ELEMENTS)
    ]
    return joined(parts)


def _counted_compiled(cells: MatchCells, rotation: Tensor, translation: Tensor) -> _Counted:
    """As ``_counted_of_few``, of any number of poses."""
    support = cells.last.new_empty(len(rotation))
    shares = rotation.new_empty(2, len(rotation))
    sizes = cells.source.shape[1], cells.targets.shape[1], len(cells.size), len(rotation)
    square = float(cells.threshold * cells.threshold)
    call("agreement", *(part.detach() for part in cells[:4]), rotation, translation, support, shares, *sizes, square)
    return _Counted(support, shares[0], shares[1])


def _counted_of_few(cells: MatchCells, rotation: Tensor, translation: Tensor) -> _Counted:
    """As ``_counted``, of as many poses as fit in the cache."""
    x, y, z = cells.source.unbind(0)
    square = torch.zeros((), dtype=rotation.dtype, device=rotation.device)
    for i in range(3):
        moved = rotation[:, i, 0, None] * x + rotation[:, i, 1, None] * y + rotation[:, i, 2, None] * z
        moved += translation[:, i, None]  # (H, M)
        apart = moved[:, None] - cells.targets[i]  # (H, 17, M)
        square = square + apart.mul_(apart)
    agrees = square < cells.threshold * cells.threshold
    counts = torch.stack([agrees[:, 0].long(), agrees[:, 1:].sum(dim=1)])  # (2, H, M)
    return _Counted(counts[0].sum(dim=1), *_agreeing_cells(counts, cells))


def _agreeing_cells(counts: Tensor, cells: MatchCells) -> Tensor:
    """Sum (2, H) over cells of the mean of counts (2, H, M) in each."""
    sums = torch.nn.functional.pad(counts.cumsum(dim=-1)[..., cells.last], (1, 0)).diff(dim=-1)
    shares = sums.double() / cells.size
    return shares.cumsum(dim=-1)[..., -1]  # added in the order of the cells
