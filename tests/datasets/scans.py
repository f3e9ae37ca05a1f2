"""Helpers for tests of simulated pairs of scans."""

import numpy as np
import torch

from torchreg.datasets import ScanPair
from torchreg.open3d_loader import load_open3d
from torchreg.synthetic.scene import Array
from torchreg.types.clouds import Clouds


def colors_of(cloud: Clouds) -> torch.Tensor:
    assert cloud.colors is not None
    return cloud.colors


def nearest(queries: Array, points: Array) -> tuple[Array, Array]:
    """Index of and distance to the nearest of ``points`` for each query."""
    o3d = load_open3d()
    search = o3d.core.nns.NearestNeighborSearch(o3d.core.Tensor(np.ascontiguousarray(points)))
    search.knn_index()
    index, square = search.knn_search(o3d.core.Tensor(np.ascontiguousarray(queries)), 1)
    return index.numpy()[:, 0], np.sqrt(square.numpy()[:, 0])


def in_target(pair: ScanPair) -> Array:
    R, t = pair.T_target_source[:3, :3], pair.T_target_source[:3, 3]
    return (pair.source.points.double() @ R.T + t).float().numpy()


def thinned(points: Array, voxel_size: float = 0.2) -> Array:
    """Rows of one point per voxel."""
    return np.unique(np.floor(points / voxel_size), axis=0, return_index=True)[1]
