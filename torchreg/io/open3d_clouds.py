"""To and from Open3D's point clouds."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.entry import entry
from torchreg.errors import expect, expect_in_words
from torchreg.io.numpy_clouds import cloud_of_arrays, to_numpy
from torchreg.io.placement import Viewpoint
from torchreg.open3d_loader import load_open3d
from torchreg.types import Clouds

_Array = NDArray[Any]


@entry
def from_open3d(pcd: Any, viewpoint: Viewpoint = "auto", *, dtype: torch.dtype = torch.float32) -> Clouds:  # noqa: ANN401
    """Make a batch of one from an Open3D cloud; row i stays row i.

    Origin, colors, normals and viewpoint follow the rules of ``read_cloud``, but colors out of range are refused. An
    Open3D cloud says nothing of its viewpoint, so that "auto" only assumes one; "origin" and a position are known.

    Args:
        pcd: an ``open3d.geometry.PointCloud`` or ``open3d.t.geometry.PointCloud``.
        viewpoint: "auto", "origin", ``None``, or a position in the frame of ``pcd``, in meters.
        dtype: of the result, float32 or float64.

    Raises:
        ValueError: not an Open3D cloud, no points, points that are not finite (Open3D's
            ``remove_non_finite_points`` drops them), or colors out of range.

    Example:
        >>> pcd = to_open3d(Clouds(torch.rand(5, 3)))
        >>> from_open3d(pcd).lengths
        [5]
    """
    return cloud_of_arrays("pcd", "open3d", *_arrays(pcd), viewpoint=viewpoint, dtype=dtype)


@entry
def to_open3d(cloud: Clouds, *, tensor: bool = False) -> Any:  # noqa: ANN401
    """Make an ``open3d.geometry.PointCloud`` of one cloud, its origin added, in float64.

    Args:
        cloud: a batch of one.
        tensor: make an ``open3d.t.geometry.PointCloud`` instead, likewise.

    Raises:
        ValueError: a batch of several clouds.
        ImportError: Open3D is not there.

    Example:
        >>> len(to_open3d(Clouds(torch.rand(5, 3))).points)
        5
    """
    arrays, o3d = to_numpy(cloud), load_open3d()
    there = {name: values.astype(np.float64) for name, values in arrays._asdict().items() if values is not None}
    if tensor:
        made = o3d.t.geometry.PointCloud()
        for name, values in there.items():
            made.point["positions" if name == "points" else name] = o3d.core.Tensor(values)
        return made
    made = o3d.geometry.PointCloud()
    for name, values in there.items():
        setattr(made, name, o3d.utility.Vector3dVector(values))
    return made


def _arrays(pcd: Any) -> tuple[_Array, _Array | None, _Array | None]:  # noqa: ANN401
    """Points, colors and normals, (N, 3) of any dtype; legacy or tensor cloud."""
    if hasattr(pcd, "has_colors") and hasattr(pcd, "points"):
        colors = np.array(pcd.colors) if pcd.has_colors() else None
        return np.array(pcd.points), colors, np.array(pcd.normals) if pcd.has_normals() else None
    expect(hasattr(pcd, "point"), "pcd", "an Open3D point cloud", pcd)
    keys = ("positions", "colors", "normals")
    arrays = {key: pcd.point[key].cpu().numpy() for key in keys if key in pcd.point}
    expect_in_words("positions" in arrays, "pcd", "at least one point", "none")
    return arrays["positions"], arrays.get("colors"), arrays.get("normals")
