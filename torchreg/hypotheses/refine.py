"""The best hypotheses, scored exactly and refitted to their inliers.

Local optimization as in LO-RANSAC (Chum, Matas and Kittler, DAGM 2003, doi:10.1007/978-3-540-45243-0_31), its
plain form: fit to the inliers, score again, and go on while the quality grows, or the error falls at equal quality.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.chunks import row_chunks, stable_sum
from torchreg.geometry.kabsch import from_moments
from torchreg.hypotheses.scoring import residuals

_SCORE_ELEMENTS = 1 << 20  # 8 MB of float64 a temporary


class Scored(NamedTuple):
    """Hypotheses in float64 with exact scores.

    Attributes:
        rotation: (3, 3, H).
        translation: (3, H).
        inliers: (H, M) bool.
        support: (H,) int64, the number of inliers.
        error: (H,) sum of squared residuals of the inliers, square meters.
        quality: (H,) float64, what hypotheses are compared by: the higher, the better.
    """

    rotation: Tensor
    translation: Tensor
    inliers: Tensor
    support: Tensor
    error: Tensor
    quality: Tensor

    def take(self, index: Tensor) -> Scored:
        """The hypotheses ``index`` (K,), in that order."""
        return Scored(*(part[..., index] for part in self[:2]), *(part[index] for part in self[2:]))

    def join(self, other: Scored) -> Scored:
        """These hypotheses, and then the others."""
        first = [torch.cat(parts, dim=-1) for parts in zip(self[:2], other[:2], strict=True)]
        return Scored(*first, *(torch.cat(parts) for parts in zip(self[2:], other[2:], strict=True)))

    def put(self, index: Tensor, other: Scored) -> Scored:
        """A copy with the K hypotheses ``other`` at the places ``index`` (K,)."""
        first = [mine.index_copy(-1, index, new) for mine, new in zip(self[:2], other[:2], strict=True)]
        return Scored(*first, *(mine.index_copy(0, index, new) for mine, new in zip(self[2:], other[2:], strict=True)))


Quality = Callable[[Tensor, Tensor, float], Tensor]
"""From support (H,), error (H,) and threshold to quality (H,)."""


def by_count(support: Tensor, error: Tensor, threshold: float) -> Tensor:
    """The number of inliers (RANSAC)."""
    return support.double()


def by_msac(support: Tensor, error: Tensor, threshold: float) -> Tensor:
    """The sum of 1 - (residual / threshold)^2 over the inliers: a close one counts for more than one at the threshold.

    MSAC: Torr and Zisserman, CVIU 78(1), 2000, doi:10.1006/cviu.1999.0832.
    """
    return support.double() - error / (threshold * threshold)


QUALITIES: dict[str, Quality] = {"count": by_count, "msac": by_msac}


def score(
    rotation: Tensor,
    translation: Tensor,
    source: Tensor,
    target: Tensor,
    threshold: float,
    quality: Quality = by_count,
) -> Scored:
    """Score hypotheses exactly: residual below the threshold, summed in a fixed order."""
    parts = [
        _score(rotation[..., rows], translation[:, rows], source, target, threshold)
        for rows in row_chunks(translation.shape[1], source.shape[1], _SCORE_ELEMENTS)
    ]
    inliers = torch.cat([source.new_zeros(0, source.shape[1], dtype=torch.bool), *(part[0] for part in parts)])
    error = torch.cat([source.new_zeros(0), *(part[1] for part in parts)])
    support = inliers.sum(dim=1)
    return Scored(rotation, translation, inliers, support, error, quality(support, error, threshold))


def best_first(scored: Scored) -> Tensor:
    """Order (H,) by quality, then by error, then by place."""
    by_error = scored.error.sort(stable=True).indices
    return by_error[scored.quality[by_error].sort(descending=True, stable=True).indices]


def optimize(
    scored: Scored, source: Tensor, target: Tensor, threshold: float, rounds: int, quality: Quality = by_count
) -> Scored:
    """Refit hypotheses to their inliers until none gets better, at most ``rounds`` times."""
    active = torch.arange(len(scored.support), device=source.device)
    for _ in range(rounds):
        before = scored.take(active)
        refitted = score(*fit(before.inliers, source, target), source, target, threshold, quality)
        better = refitted.quality > before.quality
        better |= (refitted.quality == before.quality) & (refitted.error < before.error)
        gained = better.nonzero()[:, 0]
        if len(gained) == 0:
            break
        active = active[gained]
        scored = scored.put(active, refitted.take(gained))
    return scored


def fit(inliers: Tensor, source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Least-squares rotations (3, 3, H) and translations (3, H) for inlier masks (H, M), order of sums fixed."""
    index, valid = _gathered(inliers)
    weight = valid.to(source.dtype)  # (H, K)
    p, q = source[:, index], target[:, index]  # (3, H, K)
    total = _sum(weight).clamp(min=1)  # (H,)
    source_mean, target_mean = _sum(p * weight) / total, _sum(q * weight) / total  # (3, H)
    p, q = (p - source_mean[..., None]) * weight, q - target_mean[..., None]
    covariance = torch.stack([_sum(p[i] * q) for i in range(3)])  # (3, 3, H)
    T = from_moments(source_mean.t(), target_mean.t(), covariance.permute(2, 0, 1))
    return T[:, :3, :3].permute(1, 2, 0), T[:, :3, 3].t()


def _sum(values: Tensor) -> Tensor:
    """Over the last dimension, in a fixed order."""
    return stable_sum(values.reshape(-1, values.shape[-1]).t()).reshape(values.shape[:-1])


def _gathered(inliers: Tensor) -> tuple[Tensor, Tensor]:
    """Places (H, K) of the inliers of masks (H, M), in order, and which of them are valid; the others are place 0."""
    count = inliers.sum(dim=1)
    width = max(1, int(count.amax())) if len(count) else 1
    place = torch.where(inliers, inliers.cumsum(dim=1) - 1, width)  # the last column takes what is no inlier
    rows = torch.arange(inliers.shape[1], device=inliers.device).expand_as(place)
    index = place.new_zeros(len(inliers), width + 1).scatter_(1, place, rows)[:, :width]
    valid = torch.arange(width, device=inliers.device) < count[:, None]
    return torch.where(valid, index, 0), valid


def _score(rotation: Tensor, translation: Tensor, source: Tensor, target: Tensor, threshold: float) -> list[Tensor]:
    square = residuals(rotation, translation, source, target)
    inliers = square < threshold * threshold
    return [inliers, _sum(torch.where(inliers, square, torch.zeros_like(square)))]
