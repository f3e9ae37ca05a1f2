"""Coverage of two clouds by each other under a transform."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, expect_shape, positive
from torchreg.geometry.se3 import apply_rotation, inverse
from torchreg.neighborhoods.coverage import coverage
from torchreg.types import Clouds


@entry
def fitness(source: Clouds, target: Clouds, T_target_source: Tensor, threshold: float) -> Tensor:
    """Share of source points with a target point nearer than the threshold.

    As ``open3d.pipelines.registration.evaluate_registration``.

    Args:
        source: B clouds.
        target: B clouds.
        T_target_source: (B, 4, 4) float64, meters, origins included.
        threshold: meters.

    Returns:
        (B,) float64; 0 for an empty cloud. No gradients.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3))
        >>> tr.metrics.fitness(cloud, cloud, torch.eye(4, dtype=torch.float64)[None], threshold=0.1)
        tensor([1.], dtype=torch.float64)
    """
    return _coverage(source, target, T_target_source, threshold)[0]


@entry
def inlier_rmse(source: Clouds, target: Clouds, T_target_source: Tensor, threshold: float) -> Tensor:
    """Root mean square distance (B,), meters, of the points that ``fitness`` counts; 0 where there are none.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3))
        >>> tr.metrics.inlier_rmse(cloud, cloud, torch.eye(4, dtype=torch.float64)[None], threshold=0.1)
        tensor([0.], dtype=torch.float64)
    """
    return _coverage(source, target, T_target_source, threshold)[1]


@entry
def overlap(source: Clouds, target: Clouds, T_target_source: Tensor, threshold: float) -> Tensor:
    """Mean over both directions of the share of points with a partner nearer than the threshold, (B,).

    As in the overlap of 3DMatch pairs (Huang et al., Predator, CVPR 2021, doi:10.1109/CVPR46437.2021.00425),
    made symmetric.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3))
        >>> tr.metrics.overlap(cloud, cloud, torch.eye(4, dtype=torch.float64)[None], threshold=0.1)
        tensor([1.], dtype=torch.float64)
    """
    forth = fitness(source, target, T_target_source, threshold)
    back = fitness(target, source, inverse(T_target_source), threshold)
    return (forth + back) / 2


def relative_transform(source: Clouds, target: Clouds, T_target_source: Tensor) -> tuple[Tensor, Tensor]:
    """Rotations (B, 3, 3) and translations (B, 3) between the frames of ``points``, origins taken out."""
    expect_shape(T_target_source, "T_target_source", (len(source), 4, 4))
    expect(len(target) == len(source), "target", f"{len(source)} clouds, as the source has", len(target))
    T = T_target_source.to(torch.float64)
    R = T[:, :3, :3]
    return R, T[:, :3, 3] + apply_rotation(R, source.origin) - target.origin


def _coverage(source: Clouds, target: Clouds, T_target_source: Tensor, threshold: float) -> tuple[Tensor, Tensor]:
    positive(threshold, "threshold")
    R, t = relative_transform(source, target, T_target_source)
    pairs = zip(source.unpack(), target.unpack(), R, t, strict=True)
    fits = [coverage(one.points, other.points, rotation, move, threshold) for one, other, rotation, move in pairs]
    empty = R.new_zeros(0)
    return (
        torch.stack([fit.fitness for fit in fits]) if fits else empty,
        torch.stack([fit.inlier_rmse for fit in fits]) if fits else empty,
    )
