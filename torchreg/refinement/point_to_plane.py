"""Point-to-plane ICP: minimize sum_i w_i ((p_i - q_i) . n_i)^2.

Chen and Medioni (Image and Vision Computing 10(3), 1992, doi:10.1016/0262-8856(92)90066-C). For a small turn a and
a shift b, p becomes p + a x p + b, and the residual r changes by (p x n) . a + n . b.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.refinement.estimator import Estimator, Matched
from torchreg.refinement.gauss_newton import CHANNELS, products, solve
from torchreg.refinement.kernels import Kernel


def point_to_plane(kernel: Kernel) -> Estimator:
    """Gauss-Newton on the distances to the planes of target points; partners are (x, y, z, normal)."""

    def terms(matched: Matched) -> Tensor:
        n = matched.partner[3:6]
        residual = plane_residual(matched)
        weight = matched.inside * kernel(residual, matched.kernel_scale)
        return products(jacobian(matched.moved, n, residual), weight)

    return Estimator(CHANNELS, terms, solve)


def plane_residual(matched: Matched) -> Tensor:
    """(p - q) . n, meters, (k, 256)."""
    x, y, z = (matched.moved - matched.partner[:3]).mul_(matched.partner[3:6]).unbind(0)
    return x.add_(y).add_(z)


def jacobian(point: Tensor, direction: Tensor, residual: Tensor) -> Tensor:
    """(7, k, 256): point x direction, direction, residual."""
    out = point.new_empty(7, *residual.shape)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        torch.mul(point[j], direction[k], out=out[i])
        out[i].sub_(point[k] * direction[j])
    out[3:6] = direction
    out[6] = residual
    return out
