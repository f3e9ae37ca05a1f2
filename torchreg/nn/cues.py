"""What a point network sees of a point and of its neighbors: numbers that no rotation and no translation changes.

Of a point: FPFH, local contrast, and its color as brightness and two opponents of it. Of a point and a neighbor, with
normals n and n', offset d, unit direction u = d / |d| and support radius r:

    |d| / r,   n.u,   n'.u,   n.n',   (n x n').u,   n.d / r,   log((b' + e) / (b + e)),   a' - a,   c' - c

where b is brightness, and a = R - (G + B) / 2 and c = (G - B) sqrt(3) / 2 span the plane of hue and saturation: gray is
its zero, so that a gray point has no hue to be wrong about. All but the first group are smooth functions of points,
normals and colors. (n x n').u alone tells a shape from its mirror image.

The cues follow the signs of the normals, as FPFH does. Without colors their columns are zero, and one column says so.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.color import colors_of
from torchreg.descriptors.contrast import CONTRAST_SIZE, contrast
from torchreg.descriptors.fpfh import fpfh
from torchreg.descriptors.fuse import rooted, unit_rows
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather
from torchreg.geometry.numerics.lengths import safe_sqrt
from torchreg.types import Clouds, Neighborhoods

POINT_CUES = 33 + CONTRAST_SIZE + 4
PAIR_CUES = 9
_FLOOR = 0.05  # of brightness, so that noise in the dark counts little


class PointCues(NamedTuple):
    """What is known of every point.

    Attributes:
        rows: (P, 47), for the first layer. Gradients flow to colors, by the last columns.
        color: (P, 3) brightness and its two opponents, zero without colors. Gradients flow.
        described: (P,) bool, whether a point has a neighbor besides itself.
    """

    rows: Tensor
    color: Tensor
    described: Tensor


def point_cues(cloud: Clouds, near: Neighborhoods) -> PointCues:
    """The cues of every point; ``near.radius`` is known and the cloud has normals."""
    detached = cloud.detach()
    geometry = fpfh(detached, near)
    shape = unit_rows(rooted(geometry.values))
    if cloud.colors is None:
        none = torch.zeros_like(cloud.points)
        spread, color, known = shape.new_zeros(len(shape), CONTRAST_SIZE), none, none[:, :1]
    else:
        assert near.radius is not None
        spread = unit_rows(contrast(detached, near, near.radius).values)
        color = opponents(colors_of(cloud))
        known = torch.ones_like(color[:, :1])
    return PointCues(torch.cat([shape, spread, color, known], dim=1), color, geometry.valid)


def opponents(colors: Tensor) -> Tensor:
    """Brightness and two opponents (P, 3) of colors (P, 3): an orthogonal view of RGB. Gradients flow."""
    red, green, blue = colors.unbind(dim=1)
    return torch.stack([(red + green + blue) / 3, red - (green + blue) / 2, (green - blue) * (math.sqrt(3) / 2)], dim=1)


def pair_cues(cloud: Clouds, color: Tensor, index: Tensor, radius: float | Tensor) -> Tensor:
    """The cues (P, K, 9) of every point and its neighbors. Gradients flow to points, normals and colors.

    Args:
        cloud: points and normals; P rows.
        color: (P, 3) of ``PointCues``.
        index: (P, K) neighbors, rows of the cloud.
        radius: meters, of the support; a number, or one per point (P,).
    """
    normals = cloud.normals
    assert normals is not None
    columns = [column.contiguous() for part in (cloud.points, normals, color) for column in part.unbind(dim=1)]
    reach = radius.to(cloud.points) if isinstance(radius, Tensor) else cloud.points.new_full((len(index),), radius)
    parts = [_pair_cues(columns, index, reach, rows) for rows in row_chunks(len(index), index.shape[1])]
    return torch.cat(parts) if parts else cloud.points.new_zeros(*index.shape, PAIR_CUES)


def _pair_cues(columns: list[Tensor], index: Tensor, reach: Tensor, rows: slice) -> Tensor:
    """The same of some points; columns are coordinates, normals and colors, nine of (P,)."""
    x, y, z, nx, ny, nz, b, a, c = (column[rows, None] for column in columns)
    other = [gather(column, index[rows]) for column in columns]  # each (R, K)
    dx, dy, dz = other[0] - x, other[1] - y, other[2] - z
    mx, my, mz = other[3:6]
    length = safe_sqrt(dx * dx + dy * dy + dz * dz)
    apart = torch.where(length > 0, length, 1)
    height = nx * dx + ny * dy + nz * dz
    twist = (ny * mz - nz * my) * dx + (nz * mx - nx * mz) * dy + (nx * my - ny * mx) * dz
    cues = [
        length / reach[rows, None],
        height / apart,
        (mx * dx + my * dy + mz * dz) / apart,
        nx * mx + ny * my + nz * mz,
        twist / apart,
        height / reach[rows, None],
        ((other[6] + _FLOOR) / (b + _FLOOR)).log(),
        other[7] - a,
        other[8] - c,
    ]
    return torch.stack(cues, dim=-1)
