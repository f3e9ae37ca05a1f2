"""Point-to-point ICP: minimize sum_i w_i |p_i - q_i|^2 (Besl and McKay, PAMI 14(2), 1992, doi:10.1109/34.121791)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.kabsch import from_moments
from torchreg.refinement.estimator import Estimator, IcpKind, MatchedBlocks, Update
from torchreg.refinement.kernels import Kernel
from torchreg.types import Clouds

_RANK = 1e-10  # of the second singular value to the first: below it the points lie on a line


def point_to_point(kernel: Kernel) -> Estimator:
    """The closed form of ``kabsch`` on the correspondences.

    Open3D has no kernel here; ours weighs a correspondence by its distance.
    """

    def terms(matched: MatchedBlocks) -> Tensor:
        """w, w p, w q and w p q^T: (16, k, 256)."""
        p, q = matched.moved, matched.partner[:3]
        x, y, z = (p - q).unbind(0)
        distance = x.mul_(x).add_(y.mul_(y)).add_(z.mul_(z)).sqrt_()
        weight = matched.inside * kernel(distance, matched.kernel_scale)
        out = p.new_empty(16, *weight.shape)
        out[0] = weight
        torch.mul(p, weight, out=out[1:4])
        torch.mul(q, weight, out=out[4:7])
        for i in range(3):
            torch.mul(q, out[1 + i], out=out[7 + 3 * i : 10 + 3 * i])
        return out

    return Estimator(16, terms, _solve)


def _solve(sums: Tensor, center: Tensor) -> Update:
    del center
    total = sums[:, :1]
    some = torch.isfinite(sums).all(dim=1) & (total[:, 0] > 0)
    moments = torch.where(some[:, None], sums, torch.zeros_like(sums)) / torch.where(some[:, None], total, 1.0)
    source_mean, target_mean = moments[:, 1:4], moments[:, 4:7]
    covariance = moments[:, 7:].view(-1, 3, 3) - source_mean[:, :, None] * target_mean[:, None, :]
    spread = torch.linalg.svdvals(covariance)  # descending
    T = from_moments(source_mean, target_mean, covariance)
    return Update(T[:, :3, :3], T[:, :3, 3], some & (spread[:, 1] > _RANK * spread[:, 0]))


def _columns(source: Clouds, target: Clouds, max_distance: Tensor) -> tuple[Tensor, Tensor]:
    del max_distance
    return target.points, source.points[:, :0]


POINT_TO_POINT = IcpKind(needs=(), columns=_columns, estimator=point_to_point)
