"""Correspondences under the true transform: how many are right, and the error of a transform over true ones."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, expect_shape, positive
from torchreg.geometry.se3 import apply_rotation, inverse, quaternion_wxyz
from torchreg.metrics.fit import relative_transform
from torchreg.metrics.pose import rmse
from torchreg.neighborhoods.point_index import nearest
from torchreg.types import Clouds, Correspondences
from torchreg.types.packing import spans


@entry
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

    Example:
        >>> import torchreg as tr
        >>> made = tr.synthetic.match_problem(100, 0.75)
        >>> tr.metrics.inlier_ratio(made.source, made.target, made.matches, made.T_target_source, threshold=0.1)
        tensor([0.2500], dtype=torch.float64)
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


@entry
def feature_match_recall(inlier_ratios: Tensor, least: float = 0.05) -> Tensor:
    """Share of pairs whose inlier ratio (B,) exceeds ``least`` (0.05 in PPFNet, CVPR 2018), a scalar.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.metrics.feature_match_recall(torch.tensor([0.02, 0.3, 0.5, 0.6]))
        tensor(0.7500, dtype=torch.float64)
    """
    expect_shape(inlier_ratios, "inlier_ratios", ("B",))
    expect(len(inlier_ratios) > 0, "inlier_ratios", "at least one pair", inlier_ratios)
    return (inlier_ratios > least).double().mean()


@entry
def rmse_of_true_matches(
    source: Clouds, target: Clouds, T_true: Tensor, T_estimated: Tensor, threshold: float
) -> Tensor:
    """Root mean square distance between source points under the two transforms, over those that overlap.

    A source point overlaps where the true transform brings it nearer to a target point than the threshold. Choi, Zhou
    and Koltun, Robust Reconstruction of Indoor Scenes, CVPR 2015, doi:10.1109/CVPR.2015.7299195, call a pair recalled
    where this is below 0.2 m (``recalled_by_rmse``).

    Args:
        source: B clouds.
        target: B clouds.
        T_true: (B, 4, 4), meters, origins included.
        T_estimated: (B, 4, 4), likewise.
        threshold: meters.

    Returns:
        (B,) float64, meters; infinite where nothing overlaps. No gradients.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3))
        >>> T = torch.eye(4, dtype=torch.float64)[None]
        >>> tr.metrics.rmse_of_true_matches(cloud, cloud, T, T, threshold=0.1)
        tensor([0.], dtype=torch.float64)
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


@entry
def rmse_by_information(T_true: Tensor, T_estimated: Tensor, information: Tensor) -> Tensor:
    """The error of ``rmse_of_true_matches`` from the information matrix of the matches, as 3DMatch has it.

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

    Example:
        >>> import torch, torchreg as tr
        >>> information = tr.metrics.information_of_matches(torch.rand(50, 3))
        >>> T = torch.eye(4, dtype=torch.float64)
        >>> tr.metrics.rmse_by_information(T[None], T[None], information[None])
        tensor([0.], dtype=torch.float64)
    """
    sizes = (("T_true", T_true, 4), ("T_estimated", T_estimated, 4), ("information", information, 6))
    for name, value, size in sizes:
        expect(value.shape[-2:] == (size, size), name, f"(..., {size}, {size})", value)
    relative = inverse(T_true.double()) @ T_estimated.double()
    error = torch.cat([relative[..., :3, 3], quaternion_wxyz(relative[..., :3, :3])[..., 1:]], dim=-1)  # (..., 6)
    wide = information.double()
    matches = wide[..., 0, 0]
    square = (error[..., None, :] @ wide @ error[..., None])[..., 0, 0].clamp(min=0)
    some = matches > 0
    mean = square / torch.where(some, matches, torch.ones_like(matches))
    return torch.where(some, mean.sqrt(), torch.full_like(mean, float("inf")))


@entry
def information_of_matches(points: Tensor) -> Tensor:
    """The information (6, 6) float64 of true matches in the form of ``gt.info``: the sum of G^T G.

    Args:
        points: (M, 3) of the source that have a true partner, meters, in the source's frame, origin included.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.metrics.information_of_matches(torch.rand(50, 3)).shape
        torch.Size([6, 6])
    """
    expect_shape(points, "points", ("M", 3))
    p = points.detach().double()
    x, y, z = p.unbind(dim=1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3)  # (M, 3, 3)
    eye = torch.eye(3, dtype=p.dtype, device=p.device).expand(len(p), 3, 3)
    G = torch.cat([eye, -2 * cross], dim=2)  # (M, 3, 6)
    return torch.einsum("mki,mkj->ij", G, G)
