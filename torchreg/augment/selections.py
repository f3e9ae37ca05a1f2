"""Choices of points: a crop to a region, a thinning far from the scanner, one point in every cube of a grid."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.arguments import checked
from torchreg.augment.augmentation import Augmentation, Tracked, checked_range, uniform, unmoved
from torchreg.errors import expect, one_of, positive
from torchreg.types import Clouds
from torchreg.types.packing import offsets_of

_MOST_CUBES = 1 << 20  # along an axis


class RandomCrop(Augmentation):
    """Keeps the points in a random region, and exactly the share drawn: ``ceil(share * points)``, at least one.

    A plane lies across a random direction; a box and a sphere lie about a random point of the cloud, the box turned at
    random about z, with edges of random proportions between 1 and 2. Rows keep their order; of points equally far,
    the first stay. Gradients flow to the values of the rows that stay. Nothing is read back from the device.

    Args:
        keep: the share of points that stays is drawn uniformly from this range, in [0, 1].
        shape: ``"plane"``, ``"box"`` or ``"sphere"``.
        probability, generator: as for ``Augmentation``.

    Raises:
        ValueError: an argument out of its range.

    Example:
        >>> crop = RandomCrop(keep=(0.5, 0.5), shape="sphere")
        >>> crop(Clouds(torch.rand(100, 3))).lengths
        [50]
    """

    @checked
    def __init__(
        self,
        *,
        keep: tuple[float, float] = (0.6, 1.0),
        shape: str = "plane",
        probability: float = 1.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        self.keep = checked_range(keep, "keep", 0, 1)
        self.shape = one_of(shape, "shape", tuple(_DEPTHS))
        self._depth = _DEPTHS[self.shape]

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """Keep the points nearest to the middle of the region, or farthest on one side of the plane."""
        count = _count_of(uniform(*self.keep, draw), len(cloud.points))
        depth = self._depth(cloud.points.detach().double(), draw)
        return Tracked(_kept_rows(cloud, depth, count), unmoved(cloud))


class RandomThin(Augmentation):
    """Keeps a random choice of points, and exactly the share drawn: ``ceil(share * points)``, at least one.

    Points are drawn one after another without replacement, each with a chance in proportion to r to the power of
    ``-falloff``, r being its distance from the viewpoint (from the zero of its frame where that is not known): 0 thins
    evenly, 2 as the beams of a scanner spread. Drawn by the least of exponential arrival times (Efraimidis and
    Spirakis, 2006, doi:10.1016/j.ipl.2005.11.003). Rows keep their order; gradients flow to the values of those that
    stay.

    Args:
        keep: the share of points that stays is drawn uniformly from this range, in [0, 1].
        falloff: is drawn uniformly from this range, in [0, 4].
        probability, generator: as for ``Augmentation``.

    Raises:
        ValueError: an argument out of its range.

    Example:
        >>> RandomThin(keep=(0.25, 0.25))(Clouds(torch.rand(100, 3))).lengths
        [25]
    """

    @checked
    def __init__(
        self,
        *,
        keep: tuple[float, float] = (0.5, 1.0),
        falloff: tuple[float, float] = (0.0, 2.0),
        probability: float = 1.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        self.keep = checked_range(keep, "keep", 0, 1)
        self.falloff = checked_range(falloff, "falloff", 0, 4)

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """Keep the points drawn."""
        count = _count_of(uniform(*self.keep, draw), len(cloud.points))
        falloff = uniform(*self.falloff, draw)
        waiting = torch.empty(len(cloud.points), dtype=torch.float64).exponential_(generator=draw)
        square = (cloud.points.detach().double() - _scanner(cloud)).square().sum(dim=1).clamp_min(1e-12)
        arrival = waiting.to(cloud.device).log() + 0.5 * falloff * square.log()
        return Tracked(_kept_rows(cloud, arrival, count), unmoved(cloud))


class RandomVoxels(Augmentation):
    """Keeps one point, drawn at random, in every cube of a grid of random size and place.

    Unlike a mean, a kept point is one that was measured, and gradients flow to its values. Rows keep their order.
    How many stay is read back from the device.

    Args:
        voxel_size: meters, the edge of the cubes is drawn uniformly from this range, above 0.
        probability, generator: as for ``Augmentation``.

    Raises:
        ValueError: an argument out of its range, or more than 2^20 cubes along an axis of a cloud.

    Example:
        >>> RandomVoxels(voxel_size=(5.0, 5.0))(Clouds(torch.rand(100, 3))).lengths[0] <= 8
        True
    """

    @checked
    def __init__(
        self,
        *,
        voxel_size: tuple[float, float],
        probability: float = 1.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        self.voxel_size = checked_range(voxel_size, "voxel_size", 0, float("inf"))
        for edge in self.voxel_size:
            positive(edge, "voxel_size")

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """Keep one point a cube."""
        size = uniform(*self.voxel_size, draw)
        start = torch.rand(3, generator=draw, dtype=torch.float64).to(cloud.device)
        shuffled = torch.randperm(len(cloud.points), generator=draw).to(cloud.device)
        key = _cube(cloud.points.detach().double(), size, start)[shuffled]
        ordered, order = key.sort(stable=True)
        first = torch.ones_like(ordered, dtype=torch.bool)
        first[1:] = ordered[1:] != ordered[:-1]
        index = shuffled[order[first]].sort().values
        return Tracked(cloud.rows(index, offsets_of([len(index)])), unmoved(cloud))


def _count_of(share: float, points: int) -> int:
    """Number of points in a share of them, rounded up: at least 1 of a cloud that has any."""
    return min(points, max(1, math.ceil(share * points)))


def _kept_rows(cloud: Clouds, rank: Tensor, count: int) -> Clouds:
    """The ``count`` rows of one cloud with the least rank (P,), in the order they came in; ties go to the first."""
    if count == len(cloud.points):
        return cloud
    index = rank.argsort(stable=True)[:count].sort().values
    return cloud.rows(index, offsets_of([count]))


def _along_direction(points: Tensor, draw: torch.Generator) -> Tensor:
    direction = torch.nn.functional.normalize(torch.randn(3, generator=draw, dtype=torch.float64), dim=0)
    return (points * direction.to(points.device)).sum(dim=1)


def _from_point(points: Tensor, draw: torch.Generator) -> Tensor:
    return _about_point(points, draw).square().sum(dim=1)


def _in_boxes(points: Tensor, draw: torch.Generator) -> Tensor:
    away = _about_point(points, draw)
    yaw, edges = uniform(-math.pi, math.pi, draw), 1 + torch.rand(3, generator=draw, dtype=torch.float64)
    x, y, z = away.unbind(1)
    turned = torch.stack([math.cos(yaw) * x - math.sin(yaw) * y, math.sin(yaw) * x + math.cos(yaw) * y, z], dim=1)
    return (turned.abs() / edges.to(points.device)).amax(dim=1)


def _about_point(points: Tensor, draw: torch.Generator) -> Tensor:
    row = torch.randint(len(points), (1,), generator=draw).to(points.device)
    return points - points[row]


def _scanner(cloud: Clouds) -> Tensor:
    """Where the scanner stood or is assumed to have stood, (1, 3) float64, or zeros without a viewpoint."""
    zero = cloud.points.new_zeros(1, 3, dtype=torch.float64)
    if cloud.viewpoint is None:
        return zero
    viewpoint = cloud.viewpoint.detach().double()
    return torch.where(viewpoint.isfinite().all(), viewpoint, zero)


def _cube(points: Tensor, size: float, start: Tensor) -> Tensor:
    """A number (P,) int64 for the cube that each point lies in; ``start`` (3,) in [0, 1) shifts the grid, in cubes."""
    cell = ((points - points.amin(dim=0)) / size + start).floor()
    fits = bool((cell < _MOST_CUBES).all())
    expect(fits, "voxel_size", f"finite points and at most {_MOST_CUBES} cubes along an axis", size)
    x, y, z = cell.long().unbind(1)
    return (x * _MOST_CUBES + y) * _MOST_CUBES + z


_DEPTHS = {"plane": _along_direction, "box": _in_boxes, "sphere": _from_point}
