"""How good correspondences are under the true transform."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape, positive
from torchreg.geometry.se3 import apply_rotation
from torchreg.metrics.fit import relative_transform
from torchreg.types import Clouds, Correspondences
from torchreg.types.packing import spans


def inlier_ratio(
    source: Clouds, target: Clouds, matches: Correspondences, T_target_source: Tensor, threshold: float
) -> Tensor:
    """Share of correspondences that the true transform brings nearer than the threshold.

    Deng, Birdal and Ilic, PPFNet, CVPR 2018, doi:10.1109/CVPR.2018.00028.

    Args:
        source: B clouds.
        target: B clouds.
        matches: of B pairs.
        T_target_source: (B, 4, 4), true, origins included.
        threshold: meters (3DMatch: 0.1).

    Returns:
        (B,) float64; 0 for a pair without correspondences. No gradients.
    """
    positive(threshold, "threshold")
    R, t = relative_transform(source, target, T_target_source)
    shares = []
    for b, (begin, end) in enumerate(spans(matches.offsets)):
        p = source.points[matches.source[begin:end]].double()
        q = target.points[matches.target[begin:end]].double()
        square = (apply_rotation(R[b], p) + t[b] - q).square().sum(dim=1)
        shares.append((square < threshold * threshold).sum() / max(end - begin, 1))
    return torch.stack(shares).double() if shares else R.new_zeros(0)


def feature_match_recall(inlier_ratios: Tensor, least: float = 0.05) -> Tensor:
    """Share of pairs whose inlier ratio (B,) exceeds ``least`` (0.05 in PPFNet, CVPR 2018), a scalar."""
    expect_shape(inlier_ratios, "inlier_ratios", ("B",))
    expect(len(inlier_ratios) > 0, "inlier_ratios", "at least one pair", inlier_ratios)
    return (inlier_ratios > least).double().mean()
