"""Points of clouds as they are, in Z order, or one for every cube: what features from elsewhere stay with.

A mean over a cube would have no feature. So thinning picks points: of every cube those that must stay, or else the one
nearest to its middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.morton import morton_order
from torchreg.types import Clouds
from torchreg.types.packing import offsets_of, spans


class KeptPoints(NamedTuple):
    """Points of a batch of clouds, each cloud in Z order."""

    cloud: Clouds
    rows: Tensor  # (Q,) int64, of the batch that they were chosen from


def kept_points(clouds: Clouds, voxel_sizes: Sequence[float | None], described: Tensor, *, every: bool) -> KeptPoints:
    """Choose points of B clouds.

    Args:
        clouds: B clouds. Those that are not finite are kept as they are.
        voxel_sizes: meters, the edge of the cubes of each; ``None`` keeps all points.
        described: (P,) bool, points that have a feature or a match, which are chosen before others.
        every: whether all of these stay, and not one for each cube.
    """
    chosen = []
    for (begin, end), voxel in zip(spans(clouds.offsets), voxel_sizes, strict=True):
        points = clouds.points[begin:end]
        rows = torch.arange(end - begin, device=points.device)
        if len(rows) > 0 and bool(torch.isfinite(points).all()):
            if voxel is not None:
                rows = _one_per_cube(points.double(), voxel, described[begin:end], every)
            rows = rows[morton_order(points[rows], offsets_of([len(rows)]))]
        chosen.append(begin + rows)
    rows = torch.cat(chosen)
    return KeptPoints(clouds.rows(rows, offsets_of(map(len, chosen))), rows)


def _one_per_cube(points: Tensor, voxel: float, described: Tensor, every: bool) -> Tensor:
    """Rows (Q,), ascending, of the points (P, 3) that stay; cubes lie as ``voxel_downsample`` has them."""
    place = (points - points.amin(dim=0)) / voxel + 0.5
    cell = place.floor()
    off_middle = (place - cell - 0.5).square().sum(dim=1)
    cube = cell.unique(dim=0, return_inverse=True)[1]
    order = off_middle.sort(stable=True).indices
    order = order[(~described[order]).byte().sort(stable=True).indices]
    order = order[cube[order].sort(stable=True).indices]
    ordered = cube[order]
    first = torch.ones_like(ordered, dtype=torch.bool)
    first[1:] = ordered[1:] != ordered[:-1]
    stays = first | described[order] if every else first
    return order[stays].sort().values
