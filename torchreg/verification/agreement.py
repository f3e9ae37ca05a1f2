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
    targets: Tensor  # (17, 3, M) the target points that are matched to them, then those of 16 other pairings
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
        return MatchCells(matches.source.t(), matches.target.t().expand(1 + _REPAIRINGS, 3, 0), none, none, threshold)
    corner = torch.floor((matches.source - matches.source.amin(dim=0)) / (_CELL * threshold)).long()
    _, cell, size = corner.unique(dim=0, return_inverse=True, return_counts=True)
    order = cell.argsort(stable=True)
    steps = [0, *(1 + (k * (count - 1)) // (_REPAIRINGS + 1) for k in range(1, _REPAIRINGS + 1))]
    rows = (order - torch.tensor(steps, device=device)[:, None]) % count  # (17, M)
    targets = matches.target.t()[:, rows].transpose(0, 1).contiguous()
    return MatchCells(matches.source.t()[:, order].contiguous(), targets, size.cumsum(0) - 1, size, threshold)


def agreement(cells: MatchCells, rotation: Tensor, translation: Tensor) -> Agreement:
    """Weigh poses (H, 3, 3), (H, 3) on matches."""
    count = cells.source.shape[1]
    if count == 0 or len(rotation) == 0:
        empty = torch.zeros(len(rotation), dtype=torch.float64, device=rotation.device)
        return Agreement(empty.long(), empty)
    parts = [
        _weigh(cells, rotation[rows], translation[rows])
        for rows in row_chunks(len(rotation), len(cells.targets) * count, _ELEMENTS)
    ]
    return joined(parts)


def _weigh(cells: MatchCells, rotation: Tensor, translation: Tensor) -> Agreement:
    """As ``agreement``, of a few poses."""
    x, y, z = cells.source.unbind(0)
    square = torch.zeros((), dtype=rotation.dtype, device=rotation.device)
    for i in range(3):
        moved = rotation[:, i, 0, None] * x + rotation[:, i, 1, None] * y + rotation[:, i, 2, None] * z
        moved += translation[:, i, None]  # (H, M)
        apart = moved[:, None] - cells.targets[:, i]  # (H, 17, M)
        square = square + apart.mul_(apart)
    agrees = square < cells.threshold * cells.threshold
    counts = torch.stack([agrees[:, 0].long(), agrees[:, 1:].sum(dim=1)])  # (2, H, M)
    agreeing, chance = _agreeing_cells(counts, cells)
    number = len(cells.size)
    surprises = [
        min(_MOST, 0.0 - log10_binomial_tail(number, int(here), max(1.0 / _REPAIRINGS, expected) / number))
        for here, expected in zip(agreeing.tolist(), (chance / _REPAIRINGS).tolist(), strict=True)
    ]
    return Agreement(counts[0].sum(dim=1), torch.tensor(surprises, dtype=torch.float64, device=rotation.device))


def _agreeing_cells(counts: Tensor, cells: MatchCells) -> Tensor:
    """Sum (2, H) over cells of the mean of counts (2, H, M) in each."""
    sums = torch.nn.functional.pad(counts.cumsum(dim=-1)[..., cells.last], (1, 0)).diff(dim=-1)
    shares = sums.double() / cells.size
    return shares.cumsum(dim=-1)[..., -1]  # added in the order of the cells
