"""SHOT: how normals (and colors) around a point lie in its local reference frame, 352 (1344) numbers.

Tombari, Salti and Di Stefano, ECCV 2010, doi:10.1007/978-3-642-15558-1_26, and with colors, ICIP 2011,
doi:10.1109/ICIP.2011.6116679. The ball around a point is cut into 32 volumes (``shot_votes``). Each has a histogram of
11 bins of (1 + n . z) / 2, with n the neighbors' normals and z the last axis of the point's frame; and with colors one
of 31 bins of their difference,

    (|L - L_k| / 100 + (|a - a_k| + |b - b_k|) / 240) / 3        of CIELAB.

A row is divided by its length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torchreg.arguments import checked_record
from torchreg.descriptors.color import colors_of
from torchreg.descriptors.descriptor import Descriptor, largest_entries, support_radius
from torchreg.descriptors.lab import lab
from torchreg.descriptors.local_frames import local_frames
from torchreg.descriptors.shot_votes import (
    VOLUMES,
    angle_coefficients,
    histograms,
    places,
    unit_rows,
    vote_steps,
    votes,
)
from torchreg.descriptors.soft.arguments import expect_finite
from torchreg.errors import expect_floating, expect_shape
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.derivatives import derivative_wanted
from torchreg.geometry.numerics.gather import gather
from torchreg.geometry.numerics.sums import NEIGHBOR_LANES, lane_sums
from torchreg.native import KERNEL_TYPES, call, native, rows
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.neighborhoods import expect_rows
from torchreg.types.precision import full_precision

SHAPE_BINS = 10  # and one more: both ends have a bin of their own
COLOR_BINS = 30
SHOT_SIZE = VOLUMES * (SHAPE_BINS + 1)
CSHOT_SIZE = SHOT_SIZE + VOLUMES * (COLOR_BINS + 1)


@full_precision
def shot(cloud: Clouds, near: Neighborhoods, *, frames: Tensor | None = None) -> Features:
    """SHOT of every point.

    Args:
        cloud: points and unit normals; P rows.
        near: the support of every point, with its radius, the point itself counted. PCL takes all neighbors within the
            radius: give enough slots.
        frames: (P, 3, 3), orthonormal axes as rows, zero where there are none (NaN, which PCL writes there, is
            refused); ``None`` for ``local_frames``.

    Returns:
        Features of one block ("shot", 352): 32 volumes (azimuth first, then shell, then half) of 11 bins. Rows have
        length 1. A point without a frame gets a zero row and is not valid. As PCL's ``SHOTEstimation``, which has NaN
        there. The same bits for any chunking, batch and number of threads, with and without gradients, and in any
        order of neighbors.

        Gradients flow to points, normals and frames, through those of ``local_frames`` too, finite everywhere. Votes
        are shared piecewise linearly, but the values jump where a neighbor passes to the next volume or bin, as in
        PCL: what it gives along the other axes goes with it. No gradient shows that. The neighborhood is held fixed.
        The backward pass computes pieces again, so memory stays that of one.

    Raises:
        ValueError: no normals, neighborhoods without a radius, shapes that do not fit, points that are not float32 or
            float64, or numbers that are not finite in their dtype.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(points=torch.rand(50, 3))
        >>> near = tr.neighbors(cloud, radius=0.5, max_neighbors=50)
        >>> cloud = tr.estimate_normals(cloud, near)
        >>> tr.shot(cloud, near).values.shape
        torch.Size([50, 352])
    """
    values = _described(cloud, near, frames, None)
    return Features(values, cloud.offsets, (("shot", SHOT_SIZE),), valid=largest_entries(values) != 0)


@full_precision
def cshot(
    cloud: Clouds, near: Neighborhoods, *, frames: Tensor | None = None, values: Tensor | None = None
) -> Features:
    """SHOT of every point with its colors.

    Args:
        cloud: points, unit normals and colors; P rows.
        near, frames: as in ``shot``.
        values: (P, 3) coordinates of color instead of L / 100, a / 120 and b / 120 of those of ``cloud``: one of about
            [0, 1] and two of about [-1, 1], of which the differences count half. PCL reads its own off a table of 4000
            steps; ours are exact.

    Returns:
        Features of one block ("cshot", 1344): the 352 of ``shot`` and 32 x 31 of colors, divided by their length
        together. All else as ``shot``; gradients flow to colors (or ``values``), too.

    Raises:
        ValueError: no colors or normals, or what ``shot`` refuses.

    Example:
        >>> import torchreg as tr
        >>> cloud = tr.datasets.mall(seed=1, angular_step=3.0).source
        >>> near = tr.neighbors(cloud, 2.0, 60)
        >>> cloud = tr.estimate_normals(cloud, near)
        >>> tr.cshot(cloud, near).values.shape[1]
        1344
    """
    if values is None:
        values = lab(colors_of(cloud))
    expect_shape(values, "values", (len(cloud.points), 3), "floating")
    values = values.to(cloud.points.dtype)
    expect_finite(values, "values")
    described = _described(cloud, near, frames, values)
    return Features(described, cloud.offsets, (("cshot", CSHOT_SIZE),), valid=largest_entries(described) != 0)


@checked_record
@dataclass(frozen=True, kw_only=True)
class Shot(Descriptor):
    """``torchreg.shot``: 352 numbers of normals in a local reference frame.

    Example:
        >>> import torchreg as tr
        >>> options = tr.RegistrationOptions(descriptors=(tr.Shot(radius=0.3),), weights=(1.0,))
        >>> options.scaled(2.0).descriptors[0].radius
        0.6
    """

    name: ClassVar[str] = "shot"
    is_batched: ClassVar[bool] = True

    @property
    def reach(self) -> float:
        """Meters: a point reads its neighbors alone."""
        return self.radius

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.shot``."""
        return shot(cloud, near)

    def unsigned(self, values: Tensor) -> Tensor:
        """Histograms of normals folded at their middle, 32 x 6: the sign of the normals mirrors them."""
        return _folded(values)


@checked_record
@dataclass(frozen=True, kw_only=True)
class Cshot(Descriptor):
    """``torchreg.cshot``: 352 numbers of normals and 992 of colors in a local reference frame.

    Example:
        >>> import torchreg as tr
        >>> options = tr.RegistrationOptions(descriptors=(tr.Cshot(radius=0.3),), weights=(1.0,))
        >>> options.scaled(2.0).descriptors[0].radius
        0.6
    """

    name: ClassVar[str] = "cshot"
    needs_colors: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    @property
    def reach(self) -> float:
        """Meters: a point reads its neighbors alone."""
        return self.radius

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.cshot``."""
        return cshot(cloud, near)

    def unsigned(self, values: Tensor) -> Tensor:
        """As ``Shot.unsigned``, and the histograms of colors."""
        return torch.cat([_folded(values[:, :SHOT_SIZE]), values[:, SHOT_SIZE:]], dim=1)


def _folded(values: Tensor) -> Tensor:
    each = values.view(len(values), VOLUMES, SHAPE_BINS + 1)
    return (each + each.flip(2))[:, :, : SHAPE_BINS // 2 + 1].flatten(1)


def _described(cloud: Clouds, near: Neighborhoods, frames: Tensor | None, colors: Tensor | None) -> Tensor:
    """Rows (P, 352 or 1344); with ``colors`` (P, 3) the latter."""
    if cloud.normals is None:
        raise ValueError("cloud: expected normals (estimate_normals gives them), got none")
    expect_rows(near, cloud)
    points, normals, radius = cloud.points, cloud.normals, support_radius(near, cloud.points)
    expect_floating(points, "points")
    normals = normals.to(points.dtype)
    expect_finite(points, "points")
    expect_finite(normals, "normals")
    if frames is None:
        frames = local_frames(cloud, near)
    else:
        expect_shape(frames, "frames", (len(points), 3, 3), "floating")
        frames = frames.to(points.dtype)
        expect_finite(frames, "frames")
    given = (points, normals, frames) if colors is None else (points, normals, frames, colors)
    wanted = derivative_wanted(*given)
    if native(*given, near.index, near.valid) and points.dtype in KERNEL_TYPES and not wanted:
        return _compiled(points, normals, frames, colors, near, radius)
    columns = [column.contiguous() for each in (points, normals) for column in each.unbind(1)]
    of_color = [] if colors is None else [column.contiguous() for column in colors.unbind(1)]
    chunks = list(row_chunks(len(points), near.max_neighbors))
    if wanted and len(chunks) > 1:
        parts = [
            checkpoint(
                _rows, columns, of_color, frames, near, radius, part, use_reentrant=False, preserve_rng_state=False
            )
            for part in chunks
        ]
    else:
        parts = [_rows(columns, of_color, frames, near, radius, part) for part in chunks]
    size = SHOT_SIZE if colors is None else CSHOT_SIZE
    return torch.cat(parts) if parts else points.new_zeros(0, size)


def _rows(
    columns: list[Tensor], of_color: list[Tensor], frames: Tensor, near: Neighborhoods, radius: Tensor, part: slice
) -> Tensor:
    """Some rows (r, 352 or 1344) of columns x, y, z and those of the normals, and of colors."""
    index, frame = near.index[part], frames[part]
    offset = [gather(column, index) - column[part, None] for column in columns[:3]]  # (r, K) each
    turned = [_dot([frame[:, axis, i, None] for i in range(3)], offset) for axis in range(3)]
    framed = (frame != 0).any(dim=2).any(dim=1)[:, None]
    square = _dot(offset, offset)
    counted = near.valid[part] & framed & (square > 0) & (square < math.inf) & (_dot(turned, turned) < math.inf)
    x, y, z = (torch.where(counted, axis, 0) for axis in turned)
    place = places(x, y, z, counted, radius[part])
    normal = [gather(column, index) for column in columns[3:]]
    cosine = _dot([frame[:, 2, i, None] for i in range(3)], normal)
    cosine = torch.where(cosine >= -1, cosine, -1).clamp(max=1)  # a number for NaN, too
    result = histograms(*votes(place, (1 + cosine) * (SHAPE_BINS / 2), counted, SHAPE_BINS), SHOT_SIZE)
    sums = lane_sums(result * result, NEIGHBOR_LANES)
    if of_color:
        lightness, a, b = ((gather(column, index) - column[part, None]).abs() for column in of_color)
        difference = ((lightness + (a + b) * 0.5) / 3).clamp(max=1)
        cast = votes(place, difference * COLOR_BINS, counted, COLOR_BINS)
        colored = histograms(*cast, CSHOT_SIZE - SHOT_SIZE)
        sums = sums + lane_sums(colored * colored, NEIGHBOR_LANES)
        result = torch.cat([result, colored], dim=1)
    return unit_rows(result, sums).to(frames.dtype)


def _dot(a: list[Tensor], b: list[Tensor]) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _compiled(
    points: Tensor, normals: Tensor, frames: Tensor, colors: Tensor | None, near: Neighborhoods, radius: Tensor
) -> Tensor:
    """As ``_rows``, of all rows."""
    dtype, count = points.dtype, len(points)
    out = points.new_empty(count, SHOT_SIZE if colors is None else CSHOT_SIZE)
    angles = torch.tensor(angle_coefficients(dtype), dtype=dtype)
    given = [each.detach().contiguous() for each in (points, normals, frames, radius[:, 0])]
    of_color = None if colors is None else colors.detach().contiguous()
    slots, sizes = (*rows(near.index), *rows(near.valid)), (count, near.max_neighbors)
    call(f"shot_{KERNEL_TYPES[dtype]}", *given, of_color, angles, len(angles), vote_steps(dtype), *slots, *sizes, out)
    return out
