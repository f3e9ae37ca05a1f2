"""Free space: a scanner saw through it, so no surface of the other scan can lie in it.

A scanner that measured a surface at range r in some direction saw nothing before it. A point of the other scan
that falls well short of r in that direction contradicts the pose, unless the scene changed in between. Points
behind the surface are hidden and count neither way. The ranges are kept as an image over the sphere, unfolded by the
octahedral map (Cigolle et al., JCGT 3(2), 2014), which has no poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.native import call, native

_NEAR_QUANTILE = 0.1
_CELL_SPACINGS = 1.5  # a cell is this many point spacings wide at the near range
_MAX_SIDE = 512


class RangeImage(NamedTuple):
    """The least range that one scanner measured in every direction."""

    viewpoint: Tensor  # (3,) float, meters, in the frame of the points
    # (S, S), meters; infinite where nothing was seen. Each cell holds the least of itself and its neighbors
    ranges: Tensor
    seen: Tensor  # (S, S) bool, cells in which the scanner measured something
    near: float  # meters; nearer points are too sparse in angle to show free space


class RangeImages(NamedTuple):
    """The images of G scanners, one after another."""

    viewpoint: Tensor  # (3, G)
    ranges: Tensor  # of all cells, image by image
    seen: Tensor  # of all cells, image by image
    first: Tensor  # (G,) int64, where each image begins
    side: Tensor  # (G,) int64, cells along each side
    near: Tensor  # (G,)


class Visibility(NamedTuple):
    """Where points lie relative to the surfaces that a scanner saw."""

    before: Tensor  # (R, N) bool, well before a surface: in free space
    on: Tensor  # (R, N) bool, at the surface


def range_image(points: Tensor, viewpoint: Tensor, spacing: float) -> RangeImage | None:
    """The image of one cloud (N, 3) seen from (3,); ``None`` if that is not known, or too close to the points."""
    if len(points) == 0 or not bool(torch.isfinite(viewpoint).all()):
        return None
    ray = (points - viewpoint).t()
    distance = _length(ray)
    near = float(distance.quantile(_NEAR_QUANTILE)) if len(distance) < 1 << 20 else float(distance.median()) / 4
    if near <= 2 * spacing:
        return None
    # the sphere has the area of an image of side 2 * sqrt(pi) radians
    side = int(min(_MAX_SIDE, max(8, 3.545 * near / (_CELL_SPACINGS * spacing))))
    far_enough = distance >= near
    cell = _cells(ray[:, far_enough], torch.tensor(side, device=points.device))
    flat = torch.full((side * side,), float("inf"), dtype=points.dtype, device=points.device)
    flat = flat.scatter_reduce_(0, cell, distance[far_enough], "amin")
    image = flat.reshape(1, 1, side, side)
    least = -torch.nn.functional.max_pool2d(-image, 3, stride=1, padding=1)
    return RangeImage(viewpoint, least[0, 0], torch.isfinite(flat).reshape(side, side), near)


def side_by_side(images: Sequence[RangeImage]) -> RangeImages:
    """G images, at least one, on one device."""
    ranges = images[0].ranges
    sides = torch.tensor([len(image.ranges) for image in images], dtype=torch.int64)
    return RangeImages(
        viewpoint=torch.stack([image.viewpoint for image in images], dim=1),
        ranges=torch.cat([image.ranges.reshape(-1) for image in images]),
        seen=torch.cat([image.seen.reshape(-1) for image in images]),
        first=(sides.square().cumsum(0) - sides.square()).to(ranges.device),
        side=sides.to(ranges.device),
        near=torch.tensor([image.near for image in images], dtype=ranges.dtype, device=ranges.device),
    )


def visibility(images: RangeImages, which: Tensor, points: Tensor, margin: Tensor) -> Visibility:
    """Where points (3, R, N), meters, lie relative to the surfaces in range images.

    ``which`` (R,) names the image of each row; points less than ``margin`` (R,) meters before a surface count as on it.
    """
    ray = points - images.viewpoint[:, which, None]
    x, y, z = ray.square().unbind(0)
    square = x.add_(y).add_(z)  # not its root, which libraries round in different ways
    cell = _cells(ray, images.side[which, None]).add_(images.first[which, None]).view(-1)
    surface = images.ranges.index_select(0, cell).view(square.shape)
    known = images.seen.index_select(0, cell).view(square.shape) & (square >= images.near.square()[which, None])
    # the margin grows with the range, since neighboring cells of a slanted surface differ in range
    slack = margin[:, None].to(surface.dtype) + 0.02 * surface
    first, last = surface - slack, surface + 2 * slack
    before = known & (first > 0) & (square < first * first)
    return Visibility(before, known & ~before & (square <= last * last))


def visible_counts(images: RangeImages, which: Tensor, points: Tensor, valid: Tensor, margin: Tensor) -> Tensor:
    """How many (2, R) int64 of the points (3, R, N), where ``valid`` (R, N), lie before a surface, and on one.

    As ``visibility``, but rows without an image, ``which`` is -1, have zeros.
    """
    if native(points, margin):
        return _counts_compiled(images, which, points, valid, margin)
    seen = visibility(images, which.clamp(min=0), points, margin)
    valid = valid & (which >= 0)[:, None]
    return torch.stack([(seen.before & valid).sum(dim=1), (seen.on & valid).sum(dim=1)])


def _counts_compiled(images: RangeImages, which: Tensor, points: Tensor, valid: Tensor, margin: Tensor) -> Tensor:
    """As ``visible_counts``."""
    counts = torch.empty(2, len(which), dtype=torch.int64)
    parts = (points.contiguous(), valid.contiguous(), which, margin.float())
    call("visible_counts", *parts, *images, counts, len(images.side), *valid.shape)
    return counts


def _length(vectors: Tensor) -> Tensor:
    """(...) of (3, ...)."""
    x, y, z = vectors.square().unbind(0)
    return x.add_(y).add_(z).sqrt_()


def _cells(rays: Tensor, side: Tensor) -> Tensor:
    """Cell (...,) int64 of the directions (3, ...) in images of so many cells a side, by the octahedral map."""
    x, y, z = rays.abs().unbind(0)
    size = x.add_(y).add_(z)
    x, y, z = (rays / torch.where(size > 0, size, 1.0)).unbind(0)
    folded_x = (1 - y.abs()).copysign_(x + 0.0)
    folded_y = (1 - x.abs()).copysign_(y + 0.0)
    u, v = torch.where(z >= 0, x, folded_x), torch.where(z >= 0, y, folded_y)
    half, last = side.to(rays.dtype) / 2, side - 1
    column = torch.minimum(u.add_(1).mul_(half).long().clamp_(min=0), last)
    row = torch.minimum(v.add_(1).mul_(half).long().clamp_(min=0), last)
    return row.mul_(side).add_(column)
