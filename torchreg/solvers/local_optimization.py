"""Hypotheses refitted to their inliers by least squares, those of many pairs together.

Local optimization as in LO-RANSAC (Chum, Matas and Kittler, DAGM 2003, doi:10.1007/978-3-540-45243-0_31), its
plain form: fit to the inliers, score again, and go on while the quality grows, or the error falls at equal quality.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.best_rotation import best_rotation, best_translation
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.sums import lane_sums
from torchreg.native import call, native
from torchreg.solvers.points import PairPoints
from torchreg.solvers.scoring import ERROR_SHARES, Quality, Scored, by_count, score

_SUM_ELEMENTS = 1 << 16  # half a megabyte of float64: what is summed stays in the cache


def optimize(scored: Scored, points: PairPoints, rounds: int, quality: Quality = by_count) -> Scored:
    """Refit hypotheses to their inliers until none gets better, at most ``rounds`` times."""
    scored = Scored(*(part.clone(memory_format=torch.contiguous_format) for part in scored))
    if native(*scored) and quality in ERROR_SHARES:
        return _optimized_compiled(scored, points, rounds, ERROR_SHARES[quality])
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


def _optimized_compiled(scored: Scored, points: PairPoints, rounds: int, share: float) -> Scored:
    """As ``optimize``, in place, by the quality with this share of the error."""
    poses = (scored.rotation, scored.translation, scored.pair, points.squared_thresholds()[scored.pair])
    by = (max(0, rounds), share)
    call("optimize_poses", *poses, len(scored.pair), *points.kernel_arguments(), *by, *scored[3:])
    return scored


def fit(inliers: Tensor, pair: Tensor, points: PairPoints) -> tuple[Tensor, Tensor]:
    """Least-squares rotations (3, 3, H) and translations (3, H) for inlier masks (H, M) of the pairs (H,)."""
    support = inliers.sum(dim=1)
    widest = max(1, int(support.amax())) if len(support) else 1
    none = [points.source.new_zeros(*shape, 0) for shape in ((3,), (3,), (3, 3))]
    moments = [
        _moments(inliers[rows], support[rows], pair[rows], points, widest)
        for rows in row_chunks(len(inliers), widest, _SUM_ELEMENTS)
    ]
    source_mean, target_mean, covariance = (torch.cat(part, dim=-1) for part in zip(none, *moments, strict=True))
    rotation = best_rotation(covariance)
    return rotation, best_translation(rotation, source_mean, target_mean)


def _moments(
    inliers: Tensor, support: Tensor, pair: Tensor, points: PairPoints, widest: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Means (3, R) twice and covariances (3, 3, R) of the inliers of masks (R, M), ``widest`` at most of each."""
    columns = points.source.shape[2]
    row, column = inliers.nonzero().unbind(1)  # (T,), the inliers of all hypotheses
    number = pair[row] * columns + column
    places = row * widest + torch.arange(len(row), device=row.device) - (support.cumsum(0) - support)[row]
    total = support.double().clamp(min=1)
    means, moved = [], []
    for side in (points.source, points.target):
        wide = side.new_zeros(3, len(inliers), widest)
        wide.flatten(1)[:, places] = side.flatten(1).index_select(1, number)
        means.append(lane_sums(wide) / total)  # (3, R)
        wide.flatten(1)[:, places] -= means[-1].index_select(1, row)
        moved.append(wide)
    covariance = torch.stack([lane_sums(p * moved[1]) for p in moved[0]])  # (3, 3, R)
    return means[0], means[1], covariance
