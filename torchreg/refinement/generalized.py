"""Generalized ICP (Segal, Haehnel and Thrun, RSS 2009, doi:10.15607/RSS.2009.V.021), in the form Open3D gives it.

Either point stands for a flat disk, of variance 1 along its surface and ``EPSILON`` across it:
A = 1 - (1 - EPSILON) n n^T. The difference d = p - q is weighed by both, d^T (A_q + R A_p R^T)^-1 d: across surfaces
that face alike it counts a thousand times as much as along them, so it slides along planes as point-to-plane ICP does,
and where the two planes disagree neither decides alone.

With c = n . m of the two normals, A_q + R A_p R^T has the eigenvectors n + m, n - m and n x m, with the eigenvalues
2 - (1 - EPSILON)(1 + c), 2 - (1 - EPSILON)(1 - c) and 2. So its inverse square root W, whose rows are the residuals,
needs no decomposition.

The sign of a normal says nothing here. Open3D 0.20 takes one within 8 degrees of -x for x itself, which turns its disk;
turned to x >= 0, the same normals give the same iterates.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.refinement.blocks import dot, turned
from torchreg.refinement.estimator import Estimator, IcpKind, MatchedBlocks
from torchreg.refinement.gauss_newton import CHANNELS, products, solve
from torchreg.refinement.kernels import Kernel
from torchreg.refinement.point_to_plane import jacobian, planes
from torchreg.types import Clouds

EPSILON = 1e-3
"""Of the variance across a surface to that along it: Open3D's default."""


def generalized(kernel: Kernel, normal: int = 3) -> Estimator:
    """Gauss-Newton on the three residuals W d; partners are (x, y, z, normal), ``extra`` is the source's normal.

    The kernel weighs each of the three by itself, as Open3D does. ``normal`` is the first column of the partners'.
    """

    def terms(matched: MatchedBlocks) -> Tensor:
        rows = whitening(matched.partner[normal : normal + 3], turned(matched.rotation, matched.extra))
        apart = matched.moved - matched.partner[:3]
        out: Tensor | None = None
        for row in rows.unbind(0):
            residual = dot(row, apart)
            weight = matched.inside * kernel(residual, matched.kernel_scale)
            out = products(jacobian(matched.moved, row, residual), weight, onto=out)
        return out if out is not None else apart

    return Estimator(CHANNELS, terms, solve)


def whitening(first: Tensor, second: Tensor) -> Tensor:
    """W (3, 3, ...), symmetric, of unit normals (3, ...): the inverse square root of the sum of both covariances."""
    cosine = dot(first, second).clamp(-1.0, 1.0)
    both = 0.5**0.5
    rows = torch.zeros(3, *first.shape, dtype=first.dtype, device=first.device)
    for sign in (1.0, -1.0):
        axis = first + sign * second
        square = 2 + 2 * sign * cosine  # of its length
        stronger = (2 - (1 - EPSILON) * square / 2).rsqrt() - both
        # an axis of no length has the eigenvalue 2, and nothing to add
        share = torch.where(square > 1e-12, stronger / square.clamp(min=1e-12), torch.zeros_like(square))
        for i in range(3):
            rows[i] += axis[i] * share * axis
    for i in range(3):
        rows[i, i] += both
    return rows


def _columns(source: Clouds, target: Clouds, max_distance: Tensor) -> tuple[Tensor, Tensor]:
    del max_distance
    if source.normals is None:
        raise ValueError("source: expected normals, got none")
    return planes(target), source.normals


GENERALIZED = IcpKind(needs=(("source", "normals"), ("target", "normals")), columns=_columns, estimator=generalized)
