"""The stages of the pipeline as Open3D computes them, each from and to the named types."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchreg.errors import at_least, expect_in_words, positive
from torchreg.metrics.fit import relative_transform
from torchreg.open3d_loader import load_open3d
from torchreg.reference.legacy import hybrid, point_cloud, rows, wide
from torchreg.types import Clouds, Features, Neighborhoods


class Evaluation(NamedTuple):
    """The result of ``open3d.pipelines.registration.evaluate_registration`` for B pairs.

    Attributes:
        fitness: (B,) float64, share of source points with a target point nearer than the threshold.
        inlier_rmse: (B,) float64, meters, over those points.
    """

    fitness: Tensor
    inlier_rmse: Tensor


def voxel_downsample(cloud: Clouds, voxel_size: float) -> Clouds:
    """Replace the points in every cube of a grid by their mean; one cloud, rows in the order Open3D gives them.

    Example:
        >>> import torch, torchreg as tr
        >>> len(tr.reference.open3d.voxel_downsample(tr.Clouds(torch.rand(100, 3)), 2.0).points)
        1
    """
    thinned = point_cloud(cloud).voxel_down_sample(positive(voxel_size, "voxel_size"))

    def taken(name: str) -> Tensor | None:
        return None if getattr(cloud, name) is None else rows(getattr(thinned, name)).to(cloud.points)

    return replace(
        cloud,
        points=rows(thinned.points).to(cloud.points),
        offsets=torch.tensor([0, len(thinned.points)]),
        colors=taken("colors"),
        normals=taken("normals"),
    )


def estimate_normals(cloud: Clouds, radius: float, max_neighbors: int) -> Clouds:
    """Clouds with normals that face the viewpoint, known or assumed, or their own mean point where there is none.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3))
        >>> tr.reference.open3d.estimate_normals(cloud, radius=0.5, max_neighbors=20).normals.shape
        torch.Size([50, 3])
    """

    def of_one(single: Clouds) -> Tensor:
        pcd = point_cloud(replace(single, normals=None))
        pcd.estimate_normals(hybrid(positive(radius, "radius"), at_least(max_neighbors, "max_neighbors", 3)))
        viewpoint = single.viewpoint
        given = viewpoint is not None and bool(torch.isfinite(viewpoint).all())
        towards = wide(viewpoint[0]) if viewpoint is not None and given else wide(single.points).mean(dim=0)
        pcd.orient_normals_towards_camera_location(towards.numpy())
        return rows(pcd.normals)

    return replace(cloud, normals=_each(cloud, of_one, 3).to(cloud.points))


def fpfh(cloud: Clouds, radius: float, max_neighbors: int) -> Features:
    """FPFH by ``compute_fpfh_feature`` in float64, with a hybrid search of its own.

    Args:
        cloud: points and normals; P rows.
        radius: meters, the support radius.
        max_neighbors: the nearest so many within it, the point itself counted.

    Returns:
        Features (P, 33) float64 on the CPU; zero rows are not valid.

    Raises:
        ValueError: no normals, or a number out of its range.
        ImportError: Open3D is not there.

    Example:
        >>> cloud = estimate_normals(Clouds(torch.rand(50, 3)), 0.5, 20)
        >>> fpfh(cloud, 0.5, 20).values.shape
        torch.Size([50, 33])
    """
    if cloud.normals is None:
        raise ValueError("cloud: expected normals, got none")
    positive(radius, "radius")
    at_least(max_neighbors, "max_neighbors", 1)

    def of_one(single: Clouds) -> Tensor:
        registration = load_open3d().pipelines.registration
        feature = registration.compute_fpfh_feature(point_cloud(single), hybrid(radius, max_neighbors))
        return rows(feature.data).t()

    values = _each(cloud, of_one, 33).contiguous()
    return Features(values, cloud.offsets, (("fpfh", 33),), valid=(values != 0).any(dim=1))


def neighborhoods(cloud: Clouds, radius: float, max_neighbors: int) -> Neighborhoods:
    """The neighborhoods that ``fpfh`` uses, point by point from ``KDTreeFlann``: slow, and the same to the last tie.

    Returns:
        Neighborhoods of a batch of one, float64 on the CPU.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.reference.open3d.neighborhoods(tr.Clouds(torch.rand(50, 3)), radius=0.5, max_neighbors=20).index.shape
        torch.Size([50, 20])
    """
    expect_in_words(len(cloud) == 1, "cloud", "a batch of one", f"{len(cloud)} clouds")
    count = len(cloud.points)
    index = np.arange(count)[:, None].repeat(max_neighbors, axis=1)
    valid = np.zeros((count, max_neighbors), dtype=bool)
    squares = np.zeros((count, max_neighbors))
    if count > 0:
        tree = load_open3d().geometry.KDTreeFlann(point_cloud(cloud))
        for i, point in enumerate(wide(cloud.points).numpy()):
            count, near, square = tree.search_hybrid_vector_3d(point, radius, max_neighbors)
            index[i, :count], valid[i, :count], squares[i, :count] = near, True, square
    return Neighborhoods(torch.from_numpy(index), torch.from_numpy(valid), torch.from_numpy(squares), radius)


def evaluate(source: Clouds, target: Clouds, T_target_source: Tensor, threshold: float) -> Evaluation:
    """Fitness and inlier_rmse of transforms by ``evaluate_registration``.

    Args:
        source: B clouds.
        target: B clouds.
        T_target_source: (B, 4, 4), meters, origins included.
        threshold: meters.

    Raises:
        ValueError: shapes do not fit, or a threshold that is not above 0.
        ImportError: Open3D is not there.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3))
        >>> tr.reference.open3d.evaluate(cloud, cloud, torch.eye(4, dtype=torch.float64)[None], threshold=0.1).fitness
        tensor([1.], dtype=torch.float64)
    """
    positive(threshold, "threshold")
    source, target = source.to("cpu"), target.to("cpu")
    R, t = relative_transform(source, target, wide(T_target_source))
    values = torch.zeros(2, len(source), dtype=torch.float64)
    for b, (one, other) in enumerate(zip(source.unpack(), target.unpack(), strict=True)):
        if len(one.points) == 0 or len(other.points) == 0:
            continue
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R[b].numpy(), t[b].numpy()
        registration = load_open3d().pipelines.registration
        fit = registration.evaluate_registration(point_cloud(one), point_cloud(other), threshold, T)
        values[:, b] = torch.tensor([fit.fitness, fit.inlier_rmse])
    return Evaluation(values[0], values[1])


def _each(cloud: Clouds, compute: Callable[[Clouds], Tensor], width: int) -> Tensor:
    """The rows of all clouds, computed cloud by cloud; float64."""
    empty = torch.zeros(0, width, dtype=torch.float64)
    return torch.cat([empty, *(compute(single) for single in cloud.unpack() if len(single.points) > 0)])
