"""Point-to-plane ICP: minimize sum_i w_i ((p_i - q_i) . n_i)^2.

Chen and Medioni (Image and Vision Computing 10(3), 1992, doi:10.1016/0262-8856(92)90066-C). For a small turn a and
a shift b, p becomes p + a x p + b, and the residual r changes by (p x n) . a + n . b.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.refinement.estimator import Estimator, IcpKind, MatchedBlocks
from torchreg.refinement.gauss_newton import CHANNELS, products, solve
from torchreg.refinement.kernels import Kernel, least_squares
from torchreg.types import Clouds


def point_to_plane(kernel: Kernel) -> Estimator:
    """Gauss-Newton on the distances to the planes of target points; partners are (x, y, z, normal)."""

    def terms(matched: MatchedBlocks) -> Tensor:
        n = matched.partner[3:6]
        residual = plane_residual(matched)
        weight = matched.inside * kernel(residual, matched.kernel_scale)
        return products(jacobian(matched.moved, n, residual), weight)

    return Estimator(CHANNELS, terms, solve, "icp_point_to_plane" if kernel is least_squares else "")


def plane_residual(matched: MatchedBlocks) -> Tensor:
    """The distances (k, 256) to planes, (p - q) . n, meters."""
    x, y, z = (matched.moved - matched.partner[:3]).mul_(matched.partner[3:6]).unbind(0)
    return x.add_(y).add_(z)


def jacobian(point: Tensor, direction: Tensor, residual: Tensor) -> Tensor:
    """The rows (7, k, 256) of (J, r): point x direction, direction, residual."""
    out = point.new_empty(7, *residual.shape)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        torch.mul(point[j], direction[k], out=out[i])
        out[i].sub_(point[k] * direction[j])
    out[3:6] = direction
    out[6] = residual
    return out


def planes(target: Clouds) -> Tensor:
    """The columns x, y, z, normal (N, 6) of target points."""
    if target.normals is None:
        raise ValueError("target: expected normals, got none")
    return torch.cat([target.points, target.normals], dim=1)


def _columns(source: Clouds, target: Clouds, max_distance: Tensor) -> tuple[Tensor, Tensor]:
    del max_distance
    return planes(target), source.points[:, :0]


POINT_TO_PLANE = IcpKind(needs=(("target", "normals"),), columns=_columns, estimator=point_to_plane)
