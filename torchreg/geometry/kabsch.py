"""The rigid transform that best aligns corresponding points, in closed form.

Kabsch (Acta Cryst. A32, 1976, doi:10.1107/S0567739476001873) with the reflection case of Umeyama (PAMI 13(4),
1991, doi:10.1109/34.88573): minimize sum_i w_i |R p_i + t - q_i|^2 over rotations R and translations t, the
paper's Eq. (1).

Gradients never pass through the singular value decomposition, whose derivative divides by differences of singular
values and is infinite for the points of a cube. The best rotation itself is smooth there. R maximizes tr(R H) over
rotations; turned by a small w it gives

    tr(exp([w]) R H) = tr(R H) + g.w - w.(M w) / 2 + ...,    g = (G12 - G21, G20 - G02, G01 - G10),  G = R H,
                                                             M = tr(G) I - (G + G^T) / 2,

and at the best rotation g = 0. A Newton step w = M^-1 g from there moves nothing, but its derivative with respect to
H is that of the rotation (implicit function theorem). With M held fixed each step gains one order: after two steps
first and second derivatives are exact. The eigenvalues of M are sums of two singular values (the last one negative in
the reflection case); where one is zero the points do not determine that turn, and it gets no gradient.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect
from torchreg.geometry.numerics.derivatives import derivative_wanted
from torchreg.geometry.se3 import apply_rotation, rigid

_OPEN = 100.0  # times the rounding of the dtype, relative to the largest singular value: turns below it get no gradient


@entry
def kabsch(source: Tensor, target: Tensor, weights: Tensor | None = None) -> Tensor:
    """Least-squares rigid transforms, batched.

    Args:
        source: (..., M, 3) meters.
        target: (..., M, 3) meters, row by row the same places.
        weights: (..., M), at least 0, or ``None`` for equal weights. Rows of weight zero do not count.

    Returns:
        T_target_source (..., 4, 4) of the dtype of ``source``, with det R = +1 always. Where several rotations
        are equally good (points that are collinear, coincident, fewer than 3, or have no weight at all) one of them
        is returned. Gradients flow to all inputs, of second order too, and are exact wherever the best rotation is
        unique: planar and mirrored points and equal singular values included. They are finite everywhere: a turn
        that the points do not determine gets none. The value is the same with and without gradients.

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


def with_gradient(rotation: Tensor, covariance: Tensor, v: Tensor, singular: Tensor) -> Tensor:
    """The same rotation (..., 3, 3), with its first and second derivatives with respect to the covariance.

    The rotation maximizes tr(R H) for the covariance H (..., 3, 3), the only argument with gradient; the columns of
    ``v`` are the right singular vectors of H, ``singular`` (..., 3) its singular values, descending, the last one
    negative in the reflection case. The value is that of ``rotation`` to the last digit: the steps subtract their own
    value.
    """
    inverse = _inverse_stiffness(v, singular)
    for _ in range(2):
        G = rotation @ covariance
        pull = torch.stack([G[..., 1, 2] - G[..., 2, 1], G[..., 2, 0] - G[..., 0, 2], G[..., 0, 1] - G[..., 1, 0]], -1)
        turn = (inverse @ pull[..., None])[..., 0]
        rotation = rotation + _cayley(turn - turn.detach()) @ rotation
    return rotation


def _inverse_stiffness(v: Tensor, singular: Tensor) -> Tensor:
    """The inverse (..., 3, 3) of M over the turns that the points determine, zero over the others."""
    s1, s2, s3 = singular.unbind(-1)
    stiffness = torch.stack([s2 + s3, s1 + s3, s1 + s2], dim=-1)
    limits = torch.finfo(singular.dtype)
    least = (_OPEN * limits.eps * s1).clamp(min=limits.tiny / limits.eps)[..., None]
    determined = stiffness > least
    inverse = torch.where(determined, 1 / torch.where(determined, stiffness, torch.ones_like(stiffness)), 0)
    return (v * inverse[..., None, :]) @ v.transpose(-1, -2)


def _cayley(turn: Tensor) -> Tensor:
    """A rotation less the identity (..., 3, 3), equal to exp([w]) - I up to third order and smooth everywhere."""
    x, y, z = turn.unbind(-1)
    zero = torch.zeros_like(x)
    rows = [torch.stack(row, dim=-1) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])]
    skew = torch.stack(rows, dim=-2)
    square = (turn * turn).sum(dim=-1)[..., None, None]
    return (skew + skew @ skew / 2) / (1 + square / 4)
