"""The rigid transform that best aligns corresponding points, in closed form.

Kabsch (Acta Cryst. A32, 1976, doi:10.1107/S0567739476001873) with the reflection case of Umeyama (PAMI 13(4),
1991, doi:10.1109/34.88573): minimize sum_i w_i |R p_i + t - q_i|^2 over rotations R and translations t, the
paper's Eq. (1).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.kabsch_gradient import with_gradient
from torchreg.geometry.numerics.derivatives import derivative_wanted
from torchreg.geometry.se3 import apply_rotation, rigid


def kabsch(source: Tensor, target: Tensor, weights: Tensor | None = None) -> Tensor:
    """Least-squares rigid transforms, batched.

    Args:
        source: (..., M, 3) meters.
        target: (..., M, 3) meters, row by row the same places.
        weights: (..., M), at least 0, or ``None`` for equal weights. Rows of weight zero do not count.

    Returns:
        T_target_source (..., 4, 4) of the dtype of ``source``, with det R = +1 always. Where the points leave
        the rotation open (collinear, coincident, fewer than 3, no weight at all) one of the best rotations is
        returned. Gradients flow to all inputs, twice if wanted, and are exact wherever the best rotation is
        unique: planar and mirrored points and equal singular values included. They are finite everywhere: a turn
        that the points leave open gets none. The value is the same with and without gradients.

    Raises:
        ValueError: shapes do not fit.

    Example:
        >>> import torch, torchreg as tr
        >>> p = torch.rand(10, 3, dtype=torch.float64)
        >>> torch.allclose(tr.kabsch(p, p + 1)[:3, 3], torch.ones(3, dtype=torch.float64))
        True
    """
    expect(source.ndim >= 2 and source.shape[-1] == 3, "source", "(..., M, 3)", source)
    expect(target.shape == source.shape, "target", f"the shape of source, {tuple(source.shape)}", target)
    if weights is None:
        weights = torch.ones_like(source[..., 0])
    expect(weights.shape == source.shape[:-1], "weights", f"{tuple(source.shape[:-1])}", weights)
    total = weights.sum(dim=-1, keepdim=True)
    some = total > 0
    share = torch.where(some, weights / torch.where(some, total, 1), 0)[..., None]  # (..., M, 1)
    source_mean, target_mean = (share * source).sum(dim=-2), (share * target).sum(dim=-2)
    spread = (share * (source - source_mean[..., None, :])).transpose(-1, -2)  # (..., 3, M)
    covariance = spread @ (target - target_mean[..., None, :])
    return from_moments(source_mean, target_mean, covariance)


def from_moments(source_mean: Tensor, target_mean: Tensor, covariance: Tensor) -> Tensor:
    """The transform (..., 4, 4) from means (..., 3) and covariance sum_i w_i p_i q_i^T (..., 3, 3)."""
    u, singular, vh = torch.linalg.svd(covariance.detach())
    v, ut = vh.transpose(-1, -2), u.transpose(-1, -2)
    sign = torch.det(v @ ut).sign()
    flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], dim=-1)  # (..., 3)
    rotation = (v * flip[..., None, :]) @ ut
    if derivative_wanted(covariance):
        rotation = with_gradient(rotation, covariance, v, singular * flip)
    return rigid(rotation, target_mean - apply_rotation(rotation, source_mean))
