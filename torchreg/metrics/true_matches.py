"""Errors over true correspondences: what registration recall asks of a transform."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape, positive
from torchreg.geometry.se3 import apply_rotation, inverse, quaternion_wxyz
from torchreg.metrics.fit import relative_transform
from torchreg.metrics.pose import rmse
from torchreg.neighborhoods.point_index import nearest
from torchreg.types import Clouds


def rmse_of_true_matches(
    source: Clouds, target: Clouds, T_true: Tensor, T_estimated: Tensor, threshold: float
) -> Tensor:
    """Root mean square distance between source points under the two transforms, over those that overlap.

    A source point overlaps where the true transform brings it nearer to a target point than the threshold. Choi, Zhou
    and Koltun, Robust Reconstruction of Indoor Scenes, CVPR 2015, doi:10.1109/CVPR.2015.7299195, call a pair found
    where this is below 0.2 m (``recalled_by_rmse``).

    Args:
        source: B clouds.
        target: B clouds.
        T_true: (B, 4, 4), meters, origins included.
        T_estimated: (B, 4, 4), likewise.
        threshold: meters.

    Returns:
        (B,) float64, meters; infinite where nothing overlaps. No gradients.
    """
    positive(threshold, "threshold")
    expect_shape(T_estimated, "T_estimated", (len(source), 4, 4))
    R, t = relative_transform(source, target, T_true)
    errors = []
    for b, (one, other) in enumerate(zip(source.unpack(), target.unpack(), strict=True)):
        moved = apply_rotation(R[b], one.points.double()) + t[b]
        overlaps = nearest(moved, other.points.double()).sq_distance < threshold * threshold
        inside = one.points[overlaps].double() + one.origin
        nothing = R.new_full((), float("inf"))
        errors.append(rmse(T_true[b].double(), T_estimated[b].double(), inside) if len(inside) > 0 else nothing)
    return torch.stack(errors) if errors else R.new_zeros(0)


def rmse_by_information(T_true: Tensor, T_estimated: Tensor, information: Tensor) -> Tensor:
    """The same by the information matrix of the true matches, as the 3DMatch benchmark has it, without their points.

    With (t, w, x, y, z) the translation and the unit quaternion of T_true^-1 T_estimated, w >= 0, and
    e = (t, x, y, z), it is sqrt(e^T I e / I[0, 0]). I is the sum of G^T G over the true matches p in the source's
    frame, G = [1 | -2 [p]x], so that G e is how far p is off. Exact for translations and for rotations about the
    origin; for both at once, to first order. Choi, Zhou and Koltun, Robust Reconstruction of Indoor Scenes, CVPR 2015,
    doi:10.1109/CVPR.2015.7299195.

    Args:
        T_true: (..., 4, 4).
        T_estimated: (..., 4, 4).
        information: (..., 6, 6), translations before rotations, as ``gt.info`` has it.

    Returns:
        (...,) float64, meters; infinite where the information holds no match.
    """
    for name, value, size in (
        ("T_true", T_true, 4),
        ("T_estimated", T_estimated, 4),
        ("information", information, 6),
    ):
        expect(value.shape[-2:] == (size, size), name, f"(..., {size}, {size})", value)
    relative = inverse(T_true.double()) @ T_estimated.double()
    error = torch.cat([relative[..., :3, 3], quaternion_wxyz(relative[..., :3, :3])[..., 1:]], dim=-1)  # (..., 6)
    wide = information.double()
    matches = wide[..., 0, 0]
    square = (error[..., None, :] @ wide @ error[..., None])[..., 0, 0].clamp(min=0)
    there = matches > 0
    mean = square / torch.where(there, matches, torch.ones_like(matches))
    return torch.where(there, mean.sqrt(), torch.full_like(mean, float("inf")))


def information_of_matches(points: Tensor) -> Tensor:
    """The information (6, 6) float64 of true matches in the form of ``gt.info``: the sum of G^T G.

    Args:
        points: (M, 3) of the source that have a true partner, meters, in the source's frame, origin included.
    """
    expect_shape(points, "points", ("M", 3))
    p = points.detach().double()
    x, y, z = p.unbind(dim=1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3)  # (M, 3, 3)
    eye = torch.eye(3, dtype=p.dtype, device=p.device).expand(len(p), 3, 3)
    G = torch.cat([eye, -2 * cross], dim=2)  # (M, 3, 6)
    return torch.einsum("mki,mkj->ij", G, G)
