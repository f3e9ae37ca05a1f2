"""Gradients of the best rotation that never pass through a singular value decomposition.

The derivative of an SVD divides by differences of singular values, so it is infinite for the points of a cube. The
best rotation itself is smooth there. R maximizes tr(R H) over rotations; turned by a small w it gives

    tr(exp([w]) R H) = tr(R H) + g.w - w.(M w) / 2 + ...,    g = (G12 - G21, G20 - G02, G01 - G10),  G = R H,
                                                             M = tr(G) I - (G + G^T) / 2,

and at the best rotation g = 0. A Newton step w = M^-1 g from there moves nothing, but its derivative with respect to
H is that of the rotation (implicit function theorem). With M held fixed each step gains one order: after two steps
first and second derivatives are exact. The eigenvalues of M are sums of two singular values (the last one negative in
the reflection case); where one is zero the points leave that turn open, and it gets no gradient.
"""

from __future__ import annotations

import torch
from torch import Tensor

_OPEN = 100.0  # times the rounding of the dtype, relative to the largest singular value


def with_gradient(rotation: Tensor, covariance: Tensor, v: Tensor, singular: Tensor) -> Tensor:
    """The same rotation, with its first and second derivatives with respect to the covariance.

    Args:
        rotation: (..., 3, 3), the one that maximizes tr(R H), without gradient.
        covariance: H (..., 3, 3), with gradient.
        v: (..., 3, 3) whose columns are the right singular vectors of H, without gradient.
        singular: (..., 3) descending singular values, the last one negative in the reflection case.

    Returns:
        (..., 3, 3), equal to ``rotation`` to the last digit: the steps are taken relative to their own value.
    """
    inverse = _turns(v, singular)
    for _ in range(2):
        G = rotation @ covariance
        pull = torch.stack([G[..., 1, 2] - G[..., 2, 1], G[..., 2, 0] - G[..., 0, 2], G[..., 0, 1] - G[..., 1, 0]], -1)
        turn = (inverse @ pull[..., None])[..., 0]
        rotation = rotation + _cayley(turn - turn.detach()) @ rotation
    return rotation


def _turns(v: Tensor, singular: Tensor) -> Tensor:
    """The inverse (..., 3, 3) of M over the turns that the points decide, zero over those that they leave open."""
    s1, s2, s3 = singular.unbind(-1)
    stiffness = torch.stack([s2 + s3, s1 + s3, s1 + s2], dim=-1)
    limits = torch.finfo(singular.dtype)
    least = (_OPEN * limits.eps * s1).clamp(min=limits.tiny / limits.eps)[..., None]
    decided = stiffness > least
    inverse = torch.where(decided, 1 / torch.where(decided, stiffness, torch.ones_like(stiffness)), 0)
    return (v * inverse[..., None, :]) @ v.transpose(-1, -2)


def _cayley(turn: Tensor) -> Tensor:
    """A rotation less the identity (..., 3, 3), equal to exp([w]) - I up to third order and smooth everywhere."""
    x, y, z = turn.unbind(-1)
    zero = torch.zeros_like(x)
    rows = [torch.stack(row, dim=-1) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])]
    skew = torch.stack(rows, dim=-2)
    square = (turn * turn).sum(dim=-1)[..., None, None]
    return (skew + skew @ skew / 2) / (1 + square / 4)
