"""To and from Open3D's point clouds."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.entry import entry
from torchreg.errors import expect
from torchreg.io.assemble import RawCloud, assemble, checked_dtype, scale_colors
from torchreg.io.placement import Viewpoint, checked_viewpoint
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
    wanted, dtype = checked_viewpoint(viewpoint), checked_dtype(dtype)
    points, colors, normals = _arrays(pcd)
    expect(len(points) > 0, "pcd", "at least one point", "none")
    bad = int((~np.isfinite(points).all(axis=1)).sum())
    expect(bad == 0, "pcd", "finite points", f"{bad} of {len(points)} with NaN or infinity")
    usable = colors is None or scale_colors(colors).values is not None
    expect(usable, "pcd", "colors from 0 to 1, or of 8 or 16 bits", "others")
    raw = RawCloud(name="pcd", format="open3d", points=points, colors=colors, normals=normals)
    return assemble(raw, wanted, dtype).cloud


@entry
def to_open3d(cloud: Clouds) -> Any:  # noqa: ANN401
    """Make an ``open3d.geometry.PointCloud`` of one cloud, its origin added, in float64.

    Raises:
        ValueError: a batch of several clouds.
        ImportError: Open3D is not there.

    Example:
        >>> len(to_open3d(Clouds(torch.rand(5, 3))).points)
        5
    """
    expect(len(cloud) == 1, "cloud", "a batch of one (cloud.select(b) picks one)", f"{len(cloud)} clouds")
    o3d = load_open3d()
    wide = cloud.to(device="cpu", dtype=torch.float64)
    pcd = o3d.geometry.PointCloud()
    for name, values in (("points", wide.points + wide.origin), ("colors", wide.colors), ("normals", wide.normals)):
        if values is not None:
            setattr(pcd, name, o3d.utility.Vector3dVector(values.detach().numpy()))
    return pcd


def _arrays(pcd: Any) -> tuple[_Array, _Array | None, _Array | None]:  # noqa: ANN401
    """Points (N, 3) float64, colors (N, 3) of any dtype, normals (N, 3) float64; legacy or tensor cloud."""
    if hasattr(pcd, "has_colors") and hasattr(pcd, "points"):
        colors = np.array(pcd.colors) if pcd.has_colors() else None
        return np.array(pcd.points), colors, np.array(pcd.normals) if pcd.has_normals() else None
    expect(hasattr(pcd, "point"), "pcd", "an Open3D point cloud", pcd)
    keys = ("positions", "colors", "normals")
    arrays = {key: pcd.point[key].cpu().numpy() for key in keys if key in pcd.point}
    expect("positions" in arrays, "pcd", "at least one point", "none")
    for key, values in arrays.items():
        expect(values.shape == (len(values), 3), "pcd", f"{key} (N, 3)", values.shape)
    normals = arrays["normals"].astype(np.float64) if "normals" in arrays else None
    return arrays["positions"].astype(np.float64), arrays.get("colors"), normals
