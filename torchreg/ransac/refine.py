"""The best hypotheses, scored exactly and refitted to their inliers.

Local optimization as in LO-RANSAC (Chum, Matas and Kittler, DAGM 2003, doi:10.1007/978-3-540-45243-0_31), its
plain form: fit to the inliers, count again, and go on while the count grows, or the error falls at equal count.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.chunks import stable_sum
from torchreg.geometry.kabsch import from_moments
from torchreg.ransac.scoring import residuals


class Scored(NamedTuple):
    """Hypotheses in float64 with exact scores.

    Attributes:
        rotation: (3, 3, H).
        translation: (3, H).
        inliers: (H, M) bool.
        support: (H,) int64, the number of inliers.
        error: (H,) sum of squared residuals of the inliers, square meters.
    """

    rotation: Tensor
    translation: Tensor
    inliers: Tensor
    support: Tensor
    error: Tensor

    def take(self, index: Tensor) -> Scored:
        """The hypotheses ``index`` (K,), in that order."""
        rotation, translation = self.rotation[..., index], self.translation[..., index]
        return Scored(rotation, translation, self.inliers[index], self.support[index], self.error[index])


def score(rotation: Tensor, translation: Tensor, source: Tensor, target: Tensor, threshold: float) -> Scored:
    """Score hypotheses exactly: residual below the threshold, summed in a fixed order."""
    square = residuals(rotation, translation, source, target)
    inliers = square < threshold * threshold
    error = stable_sum(torch.where(inliers, square, torch.zeros_like(square)).t())
    return Scored(rotation, translation, inliers, inliers.sum(dim=1), error)


def best_first(scored: Scored) -> Tensor:
    """Order (H,) by count, then by error, then by place."""
    by_error = scored.error.sort(stable=True).indices
    return by_error[scored.support[by_error].sort(descending=True, stable=True).indices]


def optimize(scored: Scored, source: Tensor, target: Tensor, threshold: float, rounds: int) -> Scored:
    """Refit hypotheses to their inliers until none gets better, at most ``rounds`` times."""
    for _ in range(rounds):
        refitted = score(*fit(scored.inliers, source, target), source, target, threshold)
        better = refitted.support > scored.support
        better |= (refitted.support == scored.support) & (refitted.error < scored.error)
        if not bool(better.any()):
            break
        scored = Scored(
            torch.where(better, refitted.rotation, scored.rotation),
            torch.where(better, refitted.translation, scored.translation),
            torch.where(better[:, None], refitted.inliers, scored.inliers),
            torch.where(better, refitted.support, scored.support),
            torch.where(better, refitted.error, scored.error),
        )
    return scored


def fit(inliers: Tensor, source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Least-squares rotations (3, 3, H) and translations (3, H) for inlier masks (H, M), order of sums fixed."""
    weight = inliers.t().to(source.dtype)  # (M, H)
    total = stable_sum(weight).clamp(min=1)  # (H,)
    source_mean = torch.stack([stable_sum(weight * source[i, :, None]) / total for i in range(3)], dim=-1)  # (H, 3)
    target_mean = torch.stack([stable_sum(weight * target[i, :, None]) / total for i in range(3)], dim=-1)
    p = [(source[i, :, None] - source_mean[:, i]) * weight for i in range(3)]  # (M, H)
    q = [target[i, :, None] - target_mean[:, i] for i in range(3)]
    rows = [torch.stack([stable_sum(p[i] * q[j]) for j in range(3)], dim=-1) for i in range(3)]
    covariance = torch.stack(rows, dim=-2)  # (H, 3, 3)
    T = from_moments(source_mean, target_mean, covariance)
    return T[:, :3, :3].permute(1, 2, 0), T[:, :3, 3].t()
