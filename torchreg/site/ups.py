"""Which way is up in the frame of each scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from torchreg.geometry.up import floor_normal, up_of
from torchreg.preprocess.downsample import voxel_downsample
from torchreg.refinement.surfels import cube_edge
from torchreg.types import Clouds

_POINTS = 4000  # of a scan, that floors are looked for in
_LEAST = 3  # scanners that can be seen to be level
_PARALLEL = 0.002  # radians between the z axes of level scanners, with the errors of their poses
_LEANS = 0.97  # cosine between z and up: no level scanner leans more


def up_of_scans(scans: Sequence[Clouds]) -> Tensor:
    """The direction (N, 3) float64 that is up in the frame of each of N scans; NaN where nothing tells."""
    up = torch.full((len(scans), 3), torch.nan, dtype=torch.float64)
    for number, scan in enumerate(scans):
        if len(scan.points) == 0:
            continue
        cloud = scan.to(device="cpu", dtype=torch.float64)
        edge = cube_edge(cloud.points, _POINTS)
        even = cloud.points if edge is None else voxel_downsample(cloud, edge).points
        points = even.numpy()[np.random.default_rng(0).permutation(len(even))]
        place = None if cloud.viewpoint is None else cloud.viewpoint[0].numpy()
        place = None if place is None or not np.isfinite(place).all() else place
        known = bool(cloud.viewpoint_known[0])
        direction = up_of(points, place, cloud.origin[0].numpy(), known=known).direction
        if direction is not None:
            up[number] = torch.from_numpy(np.array(floor_normal(points, direction, place), dtype=np.float64))
    return up


def plumb(up: Tensor, T_world_scan: Tensor, group: Tensor) -> Tensor:
    """The directions up (N, 3) with z in the place of those of scanners that were level themselves.

    Scanners with a compensator are level to a fraction of what a floor shows. That they were is seen from their poses
    (N, 4, 4): their z axes are parallel, far closer than tripods stand by chance.

    Args:
        up: (N, 3) float64, NaN where not known.
        T_world_scan: (N, 4, 4) float64.
        group: (N,) int64, -1 where not placed.
    """
    result = up.clone()
    near = up[:, 2] >= _LEANS * torch.linalg.vector_norm(up, dim=1)
    for number in range(int(group.max()) + 1 if len(group) else 0):
        rows = (near & (group == number)).nonzero()[:, 0]
        axes = T_world_scan[rows, :3, 2]
        if len(rows) < _LEAST:
            continue
        middle = torch.nn.functional.normalize(axes.median(dim=0).values, dim=0)
        parallel = torch.linalg.vector_norm(torch.linalg.cross(axes, middle.expand_as(axes)), dim=1) <= _PARALLEL
        if 2 * int(parallel.sum()) > len(rows):
            result[rows[parallel]] = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    return result
