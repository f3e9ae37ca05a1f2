"""Hypotheses refitted to their inliers by least squares, those of many pairs together.

Local optimization as in LO-RANSAC (Chum, Matas and Kittler, DAGM 2003, doi:10.1007/978-3-540-45243-0_31), its
plain form: fit to the inliers, score again, and go on while the quality grows, or the error falls at equal quality.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.kabsch import from_moments
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.sums import BLOCK, RowSums
from torchreg.solvers.points import PairPoints
from torchreg.solvers.scoring import Quality, Scored, by_count, score

_SUM_ELEMENTS = 1 << 16  # half a megabyte of float64: what is summed stays in the cache


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


def fit(inliers: Tensor, pair: Tensor, points: PairPoints) -> tuple[Tensor, Tensor]:
    """Least-squares rotations (3, 3, H) and translations (3, H) for inlier masks (H, M) of the pairs (H,)."""
    support = inliers.sum(dim=1)
    widest = max(1, int(support.amax())) if len(support) else 1
    pieces = list(row_chunks(len(inliers), -(-widest // BLOCK) * BLOCK, _SUM_ELEMENTS))
    sums = RowSums(pieces[0].stop if pieces else 0, widest, inliers.device)
    moments = [_moments(inliers[rows], support[rows], pair[rows], points, sums) for rows in pieces]
    if not moments:
        return points.source.new_zeros(3, 3, 0), points.source.new_zeros(3, 0)
    source_mean, target_mean, covariance = (torch.cat(part, dim=1) for part in zip(*moments, strict=True))
    T = from_moments(source_mean.t(), target_mean.t(), covariance.t().reshape(-1, 3, 3))
    return T[:, :3, :3].permute(1, 2, 0), T[:, :3, 3].t()


def _moments(
    inliers: Tensor, support: Tensor, pair: Tensor, points: PairPoints, sums: RowSums
) -> tuple[Tensor, Tensor, Tensor]:
    """Means (3, R) twice and covariances (9, R) of the inliers of masks (R, M)."""
    rows, columns = len(inliers), points.source.shape[2]
    row, column = inliers.nonzero().unbind(1)  # (T,), the inliers of all hypotheses
    places = sums.places(row, torch.arange(len(row), device=row.device) - (support.cumsum(0) - support)[row])
    number = pair[row] * columns + column
    p, q = (side.flatten(1).index_select(1, number) for side in (points.source, points.target))  # (3, T)
    total = support.double().clamp(min=1)
    means = []
    for side in (p, q):
        mean = torch.stack([sums.placed(values, places, rows) for values in side]) / total
        side -= mean.index_select(1, row)
        means.append(mean)
    covariance = torch.stack([sums.placed(a * b, places, rows) for a in p for b in q])  # (9, R)
    sums.clear(places)
    return means[0], means[1], covariance
