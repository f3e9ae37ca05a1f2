"""Free space: what a scanner saw through cannot hold a surface of the other scan.

A scanner that measured a surface at range r in some direction saw nothing before it. A point of the other scan
that falls well short of r in that direction contradicts the pose, unless the scene changed in between. Points
behind the surface say nothing: they are hidden. The ranges are kept as an image over the sphere, unfolded by the
octahedral map (Cigolle et al., JCGT 3(2), 2014), which has no poles.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

_NEAR_QUANTILE = 0.1
_CELL_SPACINGS = 1.5  # a cell is this many point spacings wide at the near range
_MAX_SIDE = 512


class RangeImage(NamedTuple):
    """The least range that one scanner measured in every direction.

    Attributes:
        viewpoint: (3,) float, meters, in the frame of the points.
        ranges: (S, S), meters; infinite where nothing was seen. Each cell holds the least of itself and its neighbors.
        seen: (S, S) bool, cells in which the scanner measured something.
        near: meters; closer than that the points are too sparse in angle to speak of free space.
    """

    viewpoint: Tensor
    ranges: Tensor
    seen: Tensor
    near: float


class Sight(NamedTuple):
    """How points stand to the surfaces that a scanner saw.

    Attributes:
        before: (..., N) bool, well before a surface: in free space.
        on: (..., N) bool, at the surface.
    """

    before: Tensor
    on: Tensor


def range_image(points: Tensor, viewpoint: Tensor, spacing: float) -> RangeImage | None:
    """The image of one cloud (N, 3) as seen from (3,); ``None`` where it says nothing, as for a scanner not known."""
    if len(points) == 0 or not bool(torch.isfinite(viewpoint).all()):
        return None
    ray = points - viewpoint
    distance = ray.square().sum(dim=1).sqrt()
    near = float(distance.quantile(_NEAR_QUANTILE)) if len(distance) < 1 << 20 else float(distance.median()) / 4
    if near <= 2 * spacing:
        return None
    # the sphere has the area of an image of side 2 * sqrt(pi) radians
    side = int(min(_MAX_SIDE, max(8, 3.545 * near / (_CELL_SPACINGS * spacing))))
    far_enough = distance >= near
    cell = _cells(ray[far_enough], side)
    flat = torch.full((side * side,), float("inf"), dtype=points.dtype, device=points.device)
    flat = flat.scatter_reduce_(0, cell, distance[far_enough], "amin")
    image = flat.reshape(1, 1, side, side)
    least = -torch.nn.functional.max_pool2d(-image, 3, stride=1, padding=1)
    return RangeImage(viewpoint, least[0, 0], torch.isfinite(flat).reshape(side, side), near)


def sight(image: RangeImage, points: Tensor, margin: float) -> Sight:
    """Where points (..., 3) stand to the image; ``margin`` in meters tells before from on."""
    ray = points - image.viewpoint
    distance = ray.square().sum(dim=-1).sqrt()
    cell = _cells(ray, image.ranges.shape[0])
    surface, seen = image.ranges.reshape(-1)[cell], image.seen.reshape(-1)[cell]
    known = seen & (distance >= image.near)
    # the margin grows with the range, since neighboring cells of a slanted surface differ in range
    slack = margin + 0.02 * surface
    before = known & (distance < surface - slack)
    return Sight(before, known & ~before & (distance <= surface + 2 * slack))


def _cells(rays: Tensor, side: int) -> Tensor:
    """Cell (...,) int64 of the directions (..., 3), by the octahedral map."""
    size = rays.abs().sum(dim=-1, keepdim=True)
    unit = rays / torch.where(size > 0, size, torch.ones_like(size))
    x, y, z = unit.unbind(-1)
    one, minus = torch.ones_like(x), -torch.ones_like(x)
    folded_x = (1 - y.abs()) * torch.where(x >= 0, one, minus)
    folded_y = (1 - x.abs()) * torch.where(y >= 0, one, minus)
    u, v = torch.where(z >= 0, x, folded_x), torch.where(z >= 0, y, folded_y)
    column = ((u + 1) * (side / 2)).long().clamp(0, side - 1)
    row = ((v + 1) * (side / 2)).long().clamp(0, side - 1)
    return row * side + column
