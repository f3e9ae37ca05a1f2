"""The best hypotheses, scored exactly and refitted to their inliers; those of many pairs together.

Local optimization as in LO-RANSAC (Chum, Matas and Kittler, DAGM 2003, doi:10.1007/978-3-540-45243-0_31), its
plain form: fit to the inliers, score again, and go on while the quality grows, or the error falls at equal quality.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.sums import BLOCK, RowSums
from torchreg.solvers.fit import fit
from torchreg.solvers.points import PairPoints
from torchreg.solvers.scoring import residuals

_SCORE_ELEMENTS = 1 << 16  # half a megabyte of float64 a temporary: they stay in the cache


class Scored(NamedTuple):
    """Hypotheses in float64 with exact scores.

    Attributes:
        rotation: (3, 3, H).
        translation: (3, H).
        pair: (H,) int64, whose hypothesis it is.
        inliers: (H, M) bool, M being that of the longest pair.
        support: (H,) int64, the number of inliers.
        error: (H,) sum of squared residuals of the inliers, square meters.
        quality: (H,) float64, what hypotheses are compared by: the higher, the better.
    """

    rotation: Tensor
    translation: Tensor
    pair: Tensor
    inliers: Tensor
    support: Tensor
    error: Tensor
    quality: Tensor

    def take(self, index: Tensor) -> Scored:
        """The hypotheses ``index`` (K,), in that order."""
        return Scored(*(part[..., index] for part in self[:2]), *(part[index] for part in self[2:]))

    def join(self, other: Scored) -> Scored:
        """Of every pair these hypotheses, and then the others."""
        first = [torch.cat(parts, dim=-1) for parts in zip(self[:2], other[:2], strict=True)]
        both = Scored(*first, *(torch.cat(parts) for parts in zip(self[2:], other[2:], strict=True)))
        return both.take(both.pair.sort(stable=True).indices)

    def put(self, index: Tensor, other: Scored) -> None:
        """Overwrite the hypotheses at the places ``index`` (K,) by K others."""
        for mine, new in zip(self[:2], other[:2], strict=True):
            mine.index_copy_(-1, index, new)
        for mine, new in zip(self[2:], other[2:], strict=True):
            mine.index_copy_(0, index, new)


Quality = Callable[[Tensor, Tensor, Tensor], Tensor]
"""From support (H,), error (H,) and squared threshold (H,) to quality (H,)."""


def by_count(support: Tensor, error: Tensor, limit: Tensor) -> Tensor:
    """The number of inliers (RANSAC)."""
    return support.double()


def by_msac(support: Tensor, error: Tensor, limit: Tensor) -> Tensor:
    """The sum of 1 - (residual / threshold)^2 over the inliers: a close one counts for more than one at the threshold.

    MSAC: Torr and Zisserman, CVIU 78(1), 2000, doi:10.1006/cviu.1999.0832.
    """
    return support.double() - error / limit


QUALITIES: dict[str, Quality] = {"count": by_count, "msac": by_msac}


def score(
    rotation: Tensor, translation: Tensor, pair: Tensor, points: PairPoints, quality: Quality = by_count
) -> Scored:
    """Score hypotheses of the pairs ``pair`` (H,) exactly: residual below the threshold, summed in a fixed order."""
    columns, limit = points.source.shape[2], points.squared_thresholds()[pair]
    inliers = points.valid.new_empty(len(pair), columns)
    error = torch.empty_like(limit)
    pieces = list(row_chunks(len(pair), -(-columns // BLOCK) * BLOCK, _SCORE_ELEMENTS))
    sums = RowSums(pieces[0].stop if pieces else 0, columns, pair.device)
    for rows in pieces:
        own = pair[rows]
        near = (points.source[:, 0], points.target[:, 0])  # one pair's points need no copy
        if len(points.counts) > 1:
            near = (points.source.index_select(1, own), points.target.index_select(1, own))
        square = residuals(rotation[..., rows], translation[:, rows], *near)
        inside = (square < limit[rows, None]).logical_and_(points.valid[own])
        inliers[rows] = inside
        error[rows] = sums(square.masked_fill_(inside.logical_not_(), 0.0))
    support = inliers.sum(dim=1)
    return Scored(rotation, translation, pair, inliers, support, error, quality(support, error, limit))


def best_first(scored: Scored) -> Tensor:
    """Order (H,) by pair, then by quality, then by error, then by place."""
    order = scored.error.sort(stable=True).indices
    order = order[scored.quality[order].sort(descending=True, stable=True).indices]
    return order[scored.pair[order].sort(stable=True).indices]


def optimize(scored: Scored, points: PairPoints, rounds: int, quality: Quality = by_count) -> Scored:
    """Refit hypotheses to their inliers until none gets better, at most ``rounds`` times."""
    scored = Scored(*(part.clone() for part in scored))
    active = torch.arange(len(scored.support), device=scored.pair.device)
    before = scored
    for _ in range(rounds):
        refitted = score(*fit(before.inliers, before.pair, points), before.pair, points, quality)
        better = refitted.quality > before.quality
        better |= (refitted.quality == before.quality) & (refitted.error < before.error)
        gained = better.nonzero()[:, 0]
        if len(gained) == 0:
            break
        active, before = active[gained], refitted.take(gained)
        scored.put(active, before)
    return scored
