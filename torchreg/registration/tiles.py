"""A cloud too large to be described at once, in tiles: each described beside the points around it that matter.

A row of a descriptor that states its ``reach`` depends on the points within that distance alone. So a tile of the
cloud, with all points as near to it as the widest reach, gives its own points the rows that the whole cloud gives
them, bit for bit: neighbors keep their order, and so do sums.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.registration.described import Description
from torchreg.types import Clouds


class Tile(NamedTuple):
    """A part of a cloud."""

    rows: Tensor  # (T,) int64, ascending, all points that are needed
    own: Tensor  # (T,) bool, those that the tile is for; every point of the cloud is some tile's


def reach_of(description: Description) -> float | None:
    """Meters: how far from a point anything can lie that changes its normal or its rows; ``None`` if anywhere.

    Keypoints that read no neighborhoods are selected on the whole cloud, and do not count.
    """
    reaches = [record.reach for record in description.descriptors]
    support = None if description.keypoints is None else description.keypoints.support
    if support is not None:
        reaches.append(support.reach if math.isfinite(support.reach) else None)
    known = [reach for reach in reaches if reach is not None]
    if len(known) < len(reaches):
        return None
    return max(known, default=0.0) + description.normal_radius


def tiles_of(cloud: Clouds, reach: float, most: int) -> list[Tile]:
    """Cut one cloud into tiles for ``most`` points of their own at most, each with all points as near as ``reach``.

    The cloud is halved across its longest side until the parts are small enough.
    """
    axes = cloud.points.t().contiguous()
    parts, tiles = [torch.arange(len(cloud.points), device=cloud.device)], []
    while parts:
        rows = parts.pop()
        own = axes[:, rows]
        low, high = own.amin(dim=1), own.amax(dim=1)
        if len(rows) > max(1, most):
            order = own[int((high - low).argmax())].argsort(stable=True)
            half = len(rows) // 2
            parts += [rows[order[half:]], rows[order[:half]]]
            continue
        # a little wider, since the search rounds
        margin = reach * (1 + 1e-3) + 1e-5 * torch.maximum(low.abs(), high.abs())
        near = ((axes >= (low - margin)[:, None]) & (axes <= (high + margin)[:, None])).all(dim=0)
        needed = near.nonzero()[:, 0]
        mine = torch.zeros_like(near)
        mine[rows] = True
        tiles.append(Tile(needed, mine[needed]))
    return tiles
