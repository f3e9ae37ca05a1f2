"""How far the matches speak for a pose: agreements of their number that chance alone would bring.

Matches within the threshold are counted and judged against what unrelated matches would give under the same pose:
each source point paired with the target points of other matches. Points that lie close together share their
neighborhoods and so their features, and their matches agree or fail together. So places are counted, not matches:
the source is cut into cells about as wide as a feature's support, and every cell counts by the share of its matches
that agree.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.chunks import row_chunks
from torchreg.geometry.se3 import apply_rotation
from torchreg.hypotheses.verdict import log10_binomial_tail

_REPAIRINGS = 16
_MOST = 400.0  # powers of ten: beyond it nothing is told apart, and numbers stay finite
_ELEMENTS = 1 << 21  # of moved points at once, 16 MB
_CELL = 3.5  # thresholds: 5 spacings, the support radius of a feature by default


class Matched(NamedTuple):
    """Matched points of one proposal: source and target (M, 3), meters, float64."""

    source: Tensor
    target: Tensor


class Agreement(NamedTuple):
    """Of H poses.

    Attributes:
        support: (H,) int64, matches within the threshold.
        surprise: (H,) float64, -log10 of the probability that unrelated matches agree in as many places; at least 0.
    """

    support: Tensor
    surprise: Tensor


def agreement(matches: Matched, rotation: Tensor, translation: Tensor, threshold: float) -> Agreement:
    """Weigh poses (H, 3, 3), (H, 3) on matches."""
    count = len(matches.source)
    if count == 0 or len(rotation) == 0:
        empty = torch.zeros(len(rotation), dtype=torch.float64, device=rotation.device)
        return Agreement(empty.long(), empty)
    cells = _cells(matches.source, _CELL * threshold)
    parts = [
        _weigh(matches, cells, rotation[rows], translation[rows], threshold)
        for rows in row_chunks(len(rotation), 3 * count, _ELEMENTS)
    ]
    return Agreement(*(torch.cat(values) for values in zip(*parts, strict=True)))


def _weigh(
    matches: Matched, cells: tuple[Tensor, Tensor], rotation: Tensor, translation: Tensor, threshold: float
) -> Agreement:
    """As ``agreement``, of a few poses."""
    count, (cell, size) = len(matches.source), cells
    moved = apply_rotation(rotation[:, None], matches.source) + translation[:, None]  # (H, M, 3)

    def agreeing(target: Tensor) -> Tensor:
        return (moved - target).square().sum(dim=-1) < threshold * threshold  # (H, M)

    agrees, chance = agreeing(matches.target), torch.zeros_like(moved[..., 0], dtype=torch.int64)
    for k in range(1, _REPAIRINGS + 1):
        chance += agreeing(matches.target.roll(1 + (k * (count - 1)) // (_REPAIRINGS + 1), 0))
    places = _places(agrees.long(), cell, size).tolist()
    by_chance = (_places(chance, cell, size) / _REPAIRINGS).tolist()
    surprises = [
        min(_MOST, 0.0 - log10_binomial_tail(len(size), int(found), max(1.0 / _REPAIRINGS, near) / len(size)))
        for found, near in zip(places, by_chance, strict=True)
    ]
    return Agreement(agrees.sum(dim=1), torch.tensor(surprises, dtype=torch.float64, device=rotation.device))


def _cells(points: Tensor, width: float) -> tuple[Tensor, Tensor]:
    """The cell (M,) int64 of every point (M, 3), numbered from 0, and the points (C,) in every cell."""
    corner = torch.floor((points - points.amin(dim=0)) / width).long()
    _, cell, size = corner.unique(dim=0, return_inverse=True, return_counts=True)
    return cell, size


def _places(counts: Tensor, cell: Tensor, size: Tensor) -> Tensor:
    """Sum (H,) over cells of the mean of counts (H, M) in each."""
    sums = torch.zeros(len(counts), len(size), dtype=torch.int64, device=counts.device).index_add_(1, cell, counts)
    shares = sums.double() / size
    return shares.cumsum(dim=1)[:, -1]  # added in the order of the cells
