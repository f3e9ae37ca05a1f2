"""Open3D's own types from tensors and back, on the CPU in float64.

Points stay relative to their cloud's origin: coordinates of UTM size would cost Open3D digits too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchreg.io.open3d_clouds import to_open3d
from torchreg.open3d_loader import load_open3d
from torchreg.types import Clouds


def point_cloud(cloud: Clouds) -> Any:  # noqa: ANN401
    """An ``open3d.geometry.PointCloud`` of a batch of one, relative to its origin."""
    return to_open3d(replace(cloud, origin=torch.zeros_like(cloud.origin)))


def feature(values: Tensor) -> Any:  # noqa: ANN401
    """An ``open3d.pipelines.registration.Feature`` of rows (P, D); Open3D holds points in columns."""
    made = load_open3d().pipelines.registration.Feature()
    made.data = wide(values).t().contiguous().numpy()
    return made


def hybrid(radius: float, max_neighbors: int) -> Any:  # noqa: ANN401
    """The parameter of a hybrid search: the nearest so many, and of those the ones within the radius in meters."""
    return load_open3d().geometry.KDTreeSearchParamHybrid(radius, max_neighbors)


def rows(values: Any) -> Tensor:  # noqa: ANN401
    """A copy (N, C) of one of Open3D's vectors, int64 or float64."""
    copied = torch.from_numpy(np.array(values))
    return copied if copied.is_floating_point() else copied.long()


def wide(values: Tensor) -> Tensor:
    """The values on the CPU in float64, without gradients."""
    return values.detach().to(device="cpu", dtype=torch.float64)
