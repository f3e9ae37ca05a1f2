r"""3D shape contexts: how many points lie in each cell of a ball around a point, 1980 numbers.

Frome, Huber, Kolluri, Buelow and Malik, ECCV 2004, doi:10.1007/978-3-540-24672-5_18, as PCL has them. The ball is cut
into cells by azimuth (equal angles around the z axis of a frame, from its x axis), elevation (equal angles from z) and
radius (equal ratios from ``inner`` x radius to the radius; the innermost cell holds what is nearer). A neighbor adds

    1 / (rho V^(1/3))

to its cell, where V is the volume of the cell and rho how many points lie within ``density`` x radius of the neighbor.

The frame. The paper leaves the azimuth open and compares all rotations; PCL draws an x axis at random, so that its
values for two scans of one place differ. Here z is the normal, and x the direction in the tangent plane in which the
neighbors spread farthest, weighted by radius - distance, with their weighted sum in front: it turns with the cloud.
``frames`` takes others, such as those of SHOT, with which the descriptor is the unique shape context (Tombari, Salti
and Di Stefano, 3DOR 2010, doi:10.1145/1877808.1877821).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchreg.arguments import checked_record
from torchreg.descriptors.descriptor import Descriptor, largest_entries, support_radius
from torchreg.descriptors.histograms import neighbor_votes
from torchreg.descriptors.pfh import expect_oriented
from torchreg.descriptors.soft.arguments import expect_binning, expect_finite
from torchreg.descriptors.soft.shape_context import soft_shape_context
from torchreg.errors import at_least, expect, expect_floating, expect_shape, fraction
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather
from torchreg.geometry.numerics.roots import square_root
from torchreg.geometry.numerics.sums import NEIGHBOR_LANES, lane_sums
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.neighborhoods import expect_rows
from torchreg.types.precision import full_precision

BINS = (12, 11, 15)
"""Of azimuth, elevation and radius."""

_VOTE_STEPS = 1 << 40  # a vote is a whole number of 1 / this, so that sums are exact


@full_precision
def shape_context(
    cloud: Clouds,
    near: Neighborhoods,
    *,
    frames: Tensor | None = None,
    bins: tuple[int, int, int] = BINS,
    inner: float = 0.1,
    density: float = 0.2,
    binning: str = "hard",
    bandwidth: float = 1.0,
) -> Features:
    """3D shape context of every point.

    Args:
        cloud: points, and unit normals where no frames are given; P rows.
        near: the support of every point, with its ``radius``, the point itself counted.
        frames: (P, 3, 3) the axes x, y and z of each point's own frame in rows, orthonormal; zero where a point has
            none. ``None``: from the normals (``tangent_frames``).
        bins: of azimuth, elevation and radius.
        inner: in (0, 1), of the radius, where the cells of radius begin; the first one holds what is nearer, too.
        density: in (0, 1], of the radius: how far around a neighbor points are counted, among its own neighbors in
            ``near``; so no more than ``max_neighbors`` are.
        binning: ``"hard"`` or ``"soft"``, where a vote passes linearly to the cells beside (``soft.votes``): in angles,
            and in the logarithm of the radius.
        bandwidth: of soft binning, in (0, 1]: the part of a cell over which a vote passes.

    Returns:
        Features of one block ("shape_context", 12 x 11 x 15 = 1980), azimuth moving slowest, radius fastest; the unit
        is 1 / m. A point without neighbors or frame gets a zero row and is not valid. The same bits for any chunking,
        batch and number of threads (soft: on the CPU). With PCL's normals, neighborhoods and drawn axes the values are
        PCL's within rounding, but for neighbors that rounding moves over the edge of a cell, and for those less than
        0.1 mm away, which PCL leaves out.

        No gradients flow through hard counts. Through soft ones they flow to points and ``frames``; frames from
        normals, densities and the neighborhood are held fixed.

    Raises:
        ValueError: neither normals nor frames, neighborhoods of unknown radius, shapes that do not fit, points that are
            not float32 or float64, numbers that are not finite in their dtype, or an option out of its range.

    Example:
        >>> import torchreg as tr
        >>> cloud = tr.datasets.mall(seed=1, angular_step=3.0).source
        >>> near = tr.neighbors(cloud, 2.0, 60)
        >>> cloud = tr.estimate_normals(cloud, near)
        >>> tr.shape_context(cloud, near).values.shape[1]
        1980
    """
    _expect_options(bins, inner, density)
    expect_binning(binning, bandwidth, edges=None, neighbor_weights=None)
    expect_floating(cloud.points, "points")
    if frames is None:
        normals = expect_oriented(cloud, near)
        frames = tangent_frames(cloud.points, normals, near)
    expect_rows(near, cloud)
    expect_shape(frames, "frames", (len(cloud.points), 3, 3), "floating")
    expect_finite(cloud.points, "points")
    frames = frames.to(cloud.points)
    expect_finite(frames, "frames")
    radius = support_radius(near, cloud.points)
    votes = 1 / near.restrict(density * radius[:, 0]).counts().clamp(min=1).to(cloud.points)
    edges = radius_edges(bins[2], inner)
    if binning == "soft":
        values = soft_shape_context(
            cloud.points, frames, votes, near, radius, bins=bins, edges=edges, bandwidth=bandwidth
        )
    else:
        values = _counted(cloud.points, frames, votes, near, radius, bins, edges)
    values = values * (_per_side(bins, edges, cloud.points) / radius)
    return Features(values, cloud.offsets, (("shape_context", values.shape[1]),), valid=largest_entries(values) != 0)


@checked_record
@dataclass(frozen=True, kw_only=True)
class ShapeContext(Descriptor):
    """``torchreg.shape_context`` in frames from the normals: 1980 numbers.

    Attributes:
        bins: of azimuth, elevation and radius.
        inner: of the radius, where the cells of radius begin.
        density: of the radius, how far around a neighbor points are counted, by which it counts less.

    Example:
        >>> import torchreg as tr
        >>> options = tr.RegistrationOptions(descriptors=(tr.ShapeContext(radius=0.3),), weights=(1.0,))
        >>> options.scaled(2.0).descriptors[0].radius
        0.6
    """

    name: ClassVar[str] = "shape_context"
    is_batched: ClassVar[bool] = True

    bins: tuple[int, int, int] = BINS
    inner: float = 0.1
    density: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "bins", tuple(self.bins))
        _expect_options(self.bins, self.inner, self.density)

    @property
    def reach(self) -> float:
        """Meters: a point reads the densities of its neighbors."""
        return (1 + self.density) * self.radius

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.shape_context``."""
        return shape_context(cloud, near, bins=self.bins, inner=self.inner, density=self.density)

    def unsigned(self, values: Tensor) -> Tensor:
        """Each cell and its mirror image in azimuth and elevation, which the sign of the normals exchanges, added."""
        cells = values.view(len(values), *self.bins)
        return (cells + cells.flip(1, 2)).view(values.shape)


def tangent_frames(points: Tensor, normals: Tensor, near: Neighborhoods) -> Tensor:
    """Frames (P, 3, 3) with the axes x, y, z in rows, which turn with the cloud.

    z is the normal; x is the direction in the tangent plane along which the neighbors spread farthest, each weighted by
    radius - distance, and their weighted sum lies in front; y = z x x. Zero where all neighbors lie on the normal.
    Where they spread alike in all directions, or lie alike in front and behind, noise decides. All lengths are parts of
    the radius, so that the unit of the points does not show. No gradients.
    """
    points, normals = points.detach(), normals.detach()
    radius, out = support_radius(near, points), points.new_zeros(len(points), 3, 3)
    columns = [column.contiguous() for column in points.unbind(1)]
    first, second = _tangents(normals)
    for rows in row_chunks(len(points), near.max_neighbors):
        votes = neighbor_votes(near.index, near.valid, rows)
        offsets = ((gather(column, near.index[rows]) - column[rows, None]) / radius[rows] for column in columns)
        dx, dy, dz = (torch.where(votes, offset, 0) for offset in offsets)
        distance = square_root(dx * dx + dy * dy + dz * dz)
        weights = torch.where(votes, 1 - distance, 0).clamp_(min=0)
        a, b = (dx * axis[rows, 0:1] + dy * axis[rows, 1:2] + dz * axis[rows, 2:3] for axis in (first, second))
        aa, ab, bb, front_a, front_b = (
            lane_sums(weights * part, NEIGHBOR_LANES) for part in (a * a, a * b, b * b, a, b)
        )
        cosine, sine = _half_angle(aa - bb, 2 * ab)
        spread = (aa + bb > 0).to(points.dtype)
        side = torch.where(cosine * front_a + sine * front_b < 0, -spread, spread)[:, None]
        x = (first[rows] * cosine[:, None] + second[rows] * sine[:, None]) * side
        out[rows, 0], out[rows, 2] = x, normals[rows] * spread[:, None]
        out[rows, 1] = torch.linalg.cross(out[rows, 2], x)
    return out


def radius_edges(count: int, inner: float) -> tuple[float, ...]:
    """Where cells of radius end, as parts of the radius: ``inner``, then equal ratios up to 1."""
    return tuple(inner ** (1 - j / count) for j in range(count + 1))


def _expect_options(bins: tuple[int, int, int], inner: float, density: float) -> None:
    expect(len(bins) == 3, "bins", "three numbers, of azimuth, elevation and radius", bins)
    for count in bins:
        at_least(count, "bins", 1)
    fraction(inner, "inner")
    expect(inner < 1, "inner", "a number below 1", inner)
    fraction(density, "density")


def _counted(
    points: Tensor,
    frames: Tensor,
    votes: Tensor,
    near: Neighborhoods,
    radius: Tensor,
    bins: tuple[int, int, int],
    edges: tuple[float, ...],
) -> Tensor:
    """(P, product of bins) sums of the votes (P,) of neighbors in each cell."""
    points, frames = points.detach(), frames.detach()
    columns = [column.contiguous() for column in points.unbind(1)]
    axes = frames.flatten(1)
    steps = (votes * _VOTE_STEPS).long()
    azimuths, elevations, squares = _cell_edges(bins, edges, points)
    size = bins[0] * bins[1] * bins[2]
    out = points.new_empty(len(points), size)
    for rows in row_chunks(len(points), max(near.max_neighbors, size)):
        index = near.index[rows]
        d = [gather(column, index) - column[rows, None] for column in columns]
        own = axes[rows, :, None]
        x, y, z = (d[0] * own[:, i] + d[1] * own[:, i + 1] + d[2] * own[:, i + 2] for i in (0, 3, 6))
        square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        counted = neighbor_votes(near.index, near.valid, rows) & (square > 0)
        counted &= (axes[rows] != 0).any(dim=1, keepdim=True)
        around = x.abs() + y.abs()
        turn = x / torch.where(around > 0, around, 1)
        turn = torch.where(y < 0, 3 + turn, 1 - turn) * (around > 0)  # grows with the azimuth, from 0 to 4
        down = -z * torch.where(square > 0, square, 1).rsqrt()
        cell = torch.bucketize(turn, azimuths) * bins[1] + torch.bucketize(down, elevations)
        cell = cell * bins[2] + torch.bucketize(square / (radius[rows] * radius[rows]), squares)
        counts = votes.new_zeros(len(index), size, dtype=torch.int64)
        counts.scatter_add_(1, cell, torch.where(counted, gather(steps, index), 0))
        torch.mul(counts.to(points.dtype), 1 / _VOTE_STEPS, out=out[rows])
    return out


def _cell_edges(bins: tuple[int, int, int], edges: tuple[float, ...], like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The inner edges of cells: of what stands for the azimuth, of minus the cosine of elevation, of squared radius."""
    turns = []
    for part in range(1, bins[0]):
        cosine, sine = math.cos(2 * math.pi * part / bins[0]), math.sin(2 * math.pi * part / bins[0])
        ratio = cosine / (abs(cosine) + abs(sine))
        turns.append(1 - ratio if 2 * part <= bins[0] else 3 + ratio)
    downs = [-math.cos(math.pi * part / bins[1]) for part in range(1, bins[1])]
    return like.new_tensor(turns), like.new_tensor(downs), like.new_tensor([edge * edge for edge in edges[1:-1]])


def _per_side(bins: tuple[int, int, int], edges: tuple[float, ...], like: Tensor) -> Tensor:
    """One by the cube root of the volume of every cell of a ball of radius 1, (product of bins,)."""
    turn = 2 * math.pi / bins[0]
    tops = [math.cos(math.pi * part / bins[1]) for part in range(bins[1] + 1)]
    one_azimuth = [
        (turn * (tops[k] - tops[k + 1]) * (edges[j + 1] ** 3 - edges[j] ** 3) / 3) ** (-1 / 3)
        for k in range(bins[1])
        for j in range(bins[2])
    ]
    return like.new_tensor(one_azimuth).repeat(bins[0])


def _tangents(normals: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors (P, 3) each at right angles with unit normals and with each other."""
    least = torch.eye(3, dtype=normals.dtype, device=normals.device)[normals.abs().argmin(dim=1)]
    first = normalize(torch.linalg.cross(normals, least), dim=1)
    return first, torch.linalg.cross(normals, first)


def _half_angle(cosine: Tensor, sine: Tensor) -> tuple[Tensor, Tensor]:
    """The direction of half the angle of (cosine, sine), of any length; (1, 0) for zero."""
    largest = torch.maximum(cosine.abs(), sine.abs())
    largest = torch.where(largest > 0, largest, 1)
    cosine, sine = cosine / largest, sine / largest  # the squares of which are neither lost nor endless
    length = square_root(cosine * cosine + sine * sine)
    share = cosine / torch.where(length > 0, length, 1)
    half_cosine = square_root(((1 + share) * 0.5).clamp(min=0))
    half_sine = torch.copysign(square_root(((1 - share) * 0.5).clamp(min=0)), sine)
    zero = length == 0
    return torch.where(zero, 1.0, half_cosine), torch.where(zero, 0.0, half_sine)
