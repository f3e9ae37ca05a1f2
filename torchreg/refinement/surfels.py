"""Surfels: a cloud as small planes that stand about evenly, each the mean of its nearest points.

A plane through many noisy points is known far better than any of them, and two scans never hit the same point; so
surfaces are refined on surfels, of which some ten thousand say as much as millions of points
(Pfister et al., Surfels, SIGGRAPH 2000, doi:10.1145/344779.344936; planes of voxels: Magnusson's NDT, 2009).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchreg.errors import expect, expect_in_words, expect_shape
from torchreg.geometry.eigen import symmetric_eigen
from torchreg.geometry.morton import occupied_cells
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.sums import lane_sums
from torchreg.native import call, native
from torchreg.neighborhoods.point_index import several_nearest
from torchreg.preprocess.downsample import CountedVoxels, counted_voxels, in_morton_order, voxel_downsample
from torchreg.types import Clouds
from torchreg.types.loading import loadable
from torchreg.types.packing import kept_rows, spans

_NEIGHBORS = 16  # points of a plane
_LEAST_NEIGHBORS = 6
_FINER = 3.0  # a surfel's cube to the cubes of the points that make it, so that each covers its cube
_FINEST = 2.0**-19  # of the extent, a surfel's cube: a third of it can still be numbered along three axes
_FLAT = 0.1  # variance across a plane to the lesser one along it
_THIN = 1e-6  # variance of points on one line, across it to along it, which have no plane
_FLATTEST = 0.2  # share of the surfels that stays at least, the flattest ones
_REACH = 2.0  # times the median squared distance to the last neighbor: what is farther belongs to other surfaces
_FLOOR = 0.05  # of the median variance, added to each: few points may lie in a plane by chance


@loadable
@dataclass(frozen=True, eq=False)
class Surfels:
    """Surfels of B clouds.

    Attributes:
        cloud: B clouds of their means, in Z order, with colors where the clouds had them, and with normals: turned to
            the scanner where its place is known, else of either sign.
        variance: (P,) squared meters, of what each is the mean of, about its plane; of the points' dtype.
        spacing: B numbers, meters between neighboring surfels; 0 where a cloud has none.
    """

    cloud: Clouds
    variance: Tensor
    spacing: tuple[float, ...]

    def __post_init__(self) -> None:
        expect_in_words(self.cloud.normals is not None, "cloud", "normals", "none")
        expect_shape(self.variance, "variance", (len(self.cloud.points),), self.cloud.points.dtype)
        expect(len(self.spacing) == len(self.cloud), "spacing", f"one per cloud ({len(self.cloud)})", self.spacing)

    def __len__(self) -> int:
        """The number of clouds, B."""
        return len(self.cloud)

    @staticmethod
    def pack(parts: Sequence[Surfels]) -> Surfels:
        """Join batches into one, in memory of its own."""
        return Surfels(
            Clouds.pack([part.cloud for part in parts]),
            torch.cat([part.variance for part in parts]),
            tuple(spacing for part in parts for spacing in part.spacing),
        )

    def unpack(self) -> list[Surfels]:
        """The clouds as batches of one; their tensors are views."""
        parts = zip(self.cloud.unpack(), spans(self.cloud.offsets), self.spacing, strict=True)
        return [Surfels(cloud, self.variance[begin:end], (spacing,)) for cloud, (begin, end), spacing in parts]

    def without(self, refused: Sequence[object]) -> Surfels:
        """The same clouds, those refused without surfels."""
        index, offsets = kept_rows(self.cloud.offsets, refused)
        index = index.to(self.cloud.device)
        return replace(self, cloud=self.cloud.rows(index, offsets), variance=self.variance[index])

    def to(self, device: torch.device | str) -> Surfels:
        """Copy to a device."""
        return replace(self, cloud=self.cloud.to(device), variance=self.variance.to(device))


def surfels_of(clouds: Clouds, count: int) -> Surfels:
    """The surfels of B clouds, about ``count`` of each at most: those that are flat enough to be planes.

    Args:
        clouds: finite points; normals are ignored.
        count: points of a cloud are first averaged over cubes so large that about as many are left; a cloud of fewer
            points gives one for each at most. At least 1.

    Returns:
        Surfels, of a cloud alone the same bits as in any batch. No gradients.
    """
    return Surfels.pack([_of_one(cloud, count) for cloud in replace(clouds.detach(), normals=None).unpack()])


def _of_one(cloud: Clouds, count: int) -> Surfels:
    dtype = cloud.points.dtype
    if len(cloud.points) < _LEAST_NEIGHBORS:
        bare = torch.zeros(0, 3, dtype=dtype, device=cloud.device)
        empty = cloud.rows(torch.zeros(0, dtype=torch.int64, device=cloud.device), torch.tensor([0, 0]))
        return Surfels(replace(empty, normals=bare), bare[:, 0], (0.0,))
    wide = cloud.to(dtype=torch.float64)
    edge = cube_edge(wide.points, count)
    base, weight = _base(wide, edge)
    if len(base.points) <= count:  # many points at few places
        edge = None
    centers = base if edge is None else voxel_downsample(base, edge)
    near = several_nearest(centers.points, base.points, _NEIGHBORS)  # (N, K)
    parts = [_planes(centers.points[rows], base, weight, near[rows]) for rows in row_chunks(len(near), _NEIGHBORS)]
    mean, normal, variances, reach, colors = (torch.cat(part) for part in zip(*parts, strict=True))
    far = _REACH * reach.median()
    kept = _flattest(variances, reach <= far)
    apart = edge or float((mean - base.points[near[:, min(4, near.shape[1] - 1)]]).square().sum(dim=1).median().sqrt())
    variance = variances[:, 0] + _FLOOR * variances[kept, 0].median() + (1e-4 * apart) ** 2
    made = replace(
        cloud,
        points=mean[kept].to(dtype),
        offsets=torch.tensor([0, int(kept.sum())]),
        colors=None if cloud.colors is None else colors[kept].to(dtype),
        normals=_faced(mean[kept], normal[kept], wide).to(dtype),
    )
    return Surfels(made, variance[kept].to(dtype), (apart,))


def _faced(points: Tensor, normals: Tensor, cloud: Clouds) -> Tensor:
    """Normals (P, 3) at points (P, 3) turned to the scanner of a batch of one, where its place is known."""
    if cloud.viewpoint is None or not bool(cloud.viewpoint_known.all()):
        return normals
    away = ((cloud.viewpoint[0] - points) * normals).sum(dim=1) < 0
    return torch.where(away[:, None], -normals, normals)


def _base(cloud: Clouds, edge: float | None) -> CountedVoxels:
    """What surfels are made of: means over a finer grid than theirs, so that they stand evenly, or all points.

    Each counts as often as it has points: a voxel that holds a surface's few farthest ones would else pull it away.
    """
    if edge is not None:
        return counted_voxels(cloud, edge / _FINER)
    return CountedVoxels(in_morton_order(cloud), cloud.points.new_ones(len(cloud.points)))


def cube_edge(points: Tensor, count: int) -> float | None:
    """Meters: the edge of cubes of which the points (P, 3) fill about ``count``; ``None`` for no more points than that.

    Read from the numbers of filled cubes of edges that double, between two of which their logarithm is about a line.
    """
    if len(points) <= count:
        return None
    extent = float((points.amax(dim=0) - points.amin(dim=0)).amax())
    filled = occupied_cells(points)
    finer = next((level for level, cells in enumerate(filled) if cells > count), None)
    if finer is None:  # many points at few places
        return max(extent, 1e-9) * _FINEST
    coarse, fine = filled[finer - 1], filled[finer]
    share = math.log(count / coarse) / math.log(fine / coarse)
    return extent * max(_FINEST, math.pow(2, 1 - finer - share))


def _planes(
    centers: Tensor, base: Clouds, weight: Tensor, near: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Means (r, 3), normals (r, 3), ascending variances (r, 3), squared reach (r,) and mean colors (r, 3) of some rows.

    The planes of neighbors (r, K), rows of ``base`` with weights (P,), about centers (r, 3).
    """
    mean, spread, reach, colors = _moments(centers, base, weight, near)
    values, vectors = symmetric_eigen(spread)
    return centers + mean, vectors[:, :, 0].contiguous(), values.clamp(min=0), reach, colors


def _freedom(neighbors: int) -> float:
    """The share of their weight that neighbors spread with about a plane through them."""
    return max(1, neighbors - 3) / neighbors


def _moments(centers: Tensor, base: Clouds, weight: Tensor, near: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Means (r, 3) about the centers, the upper triangle of spreads (r, 3, 3), reach and colors of ``_planes``."""
    if native(centers, base.points, base.colors, weight, near):
        return _moments_compiled(centers, base, weight, near)
    weights = weight[near]  # (r, K)
    total = _in_order(weights)
    apart = [base.points[:, axis][near] - centers[:, axis, None] for axis in range(3)]  # 3 x (r, K)
    reach = (apart[0] ** 2 + apart[1] ** 2 + apart[2] ** 2).amax(dim=1)
    mean = [_in_order(axis * weights) / total for axis in apart]
    apart = [axis - middle[:, None] for axis, middle in zip(apart, mean, strict=True)]
    freedom = total * _freedom(near.shape[1])
    spread = centers.new_zeros(len(centers), 3, 3)
    for i in range(3):
        for j in range(i, 3):
            spread[:, i, j] = _in_order(apart[i] * apart[j] * weights) / freedom
    colors = centers
    if base.colors is not None:
        colors = _in_order(base.colors[near] * weights[:, :, None]) / total[:, None]
    return torch.stack(mean, dim=1), spread, reach, colors


def _moments_compiled(
    centers: Tensor, base: Clouds, weight: Tensor, near: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """As ``_moments``."""
    mean, spread = torch.empty_like(centers), centers.new_zeros(len(centers), 3, 3)
    reach, colors = centers.new_empty(len(centers)), centers
    if base.colors is not None:
        colors = torch.empty_like(centers)
    given = [values if values is None else values.contiguous() for values in (base.points, weight, base.colors, near)]
    sizes = (*near.shape, _freedom(near.shape[1]))
    call("surfel_moments", centers.contiguous(), *given, *sizes, mean, spread, reach, colors)
    return mean, spread, reach, colors


def _in_order(values: Tensor) -> Tensor:
    """Sums (r, ...) of values (r, K, ...), one after another."""
    return lane_sums(values, 1, dim=1)


def _flattest(variances: Tensor, near: Tensor) -> Tensor:
    """(N,) bool: which surfels are planes; a share of them where few are, as in a wood."""
    planar = variances[:, 1] > _THIN * variances[:, 2]
    ratio = torch.where(planar, variances[:, 0] / variances[:, 1].clamp(min=1e-300), torch.inf)
    ratio = torch.where(near & torch.isfinite(variances).all(dim=1), ratio, torch.inf)
    place = max(0, math.ceil(_FLATTEST * len(ratio)) - 1)
    bound = ratio.sort().values[place].clamp(min=_FLAT)
    return torch.isfinite(ratio) & (ratio <= bound)
