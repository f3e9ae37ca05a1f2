"""Fewer points: voxel means, a random choice, farthest points. Results are in Z order.

Z order makes every later search and gather faster, since neighbors in space lie close in memory.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import at_least, expect, positive
from torchreg.geometry.morton import morton_order
from torchreg.types import Clouds
from torchreg.types.packing import offsets_of, spans


def in_morton_order(cloud: Clouds) -> Clouds:
    """The same clouds with the points of each along a Z curve."""
    return cloud.rows(morton_order(cloud.points, cloud.offsets), cloud.offsets)


@entry
def voxel_downsample(cloud: Clouds, voxel_size: float | Tensor) -> Clouds:
    """Replace the points in every cube of a grid by their mean, colors and normals likewise.

    The grid starts half a voxel below the least coordinates of a cloud, as Open3D's does.

    Args:
        cloud: B clouds.
        voxel_size: meters, the edge of a cube: a number, or one per cloud (B,).

    Returns:
        Clouds in Z order; mean normals are scaled to unit length again. The sums are made in float64 in the
        order of the points, so the result is the same in any batch. No gradients.

    Raises:
        ValueError: ``voxel_size`` not above 0, or so small against the extent that voxels cannot be numbered.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.tensor([[0.1, 0.0, 0.0], [0.3, 0.0, 0.0], [0.9, 0.0, 0.0]]))
        >>> tr.voxel_downsample(cloud, 0.5).points
        tensor([[0.2000, 0.0000, 0.0000],
                [0.9000, 0.0000, 0.0000]])
    """
    return counted_voxels(cloud, voxel_size).cloud


class CountedVoxels(NamedTuple):
    """Voxel means, and how many points each stands for."""

    cloud: Clouds  # B clouds in Z order
    points: Tensor  # (P,) float64, points of each mean


def counted_voxels(cloud: Clouds, voxel_size: float | Tensor) -> CountedVoxels:
    """As ``voxel_downsample``, with the number of points in every voxel."""
    sizes = sizes_of_clouds(voxel_size, cloud)
    spans_and_sizes = zip(spans(cloud.offsets), sizes, strict=True)
    parts = [_voxel_rows(cloud, begin, end, size) for (begin, end), size in spans_and_sizes]

    def join(which: int) -> Tensor:
        return torch.cat([part[which] for part in parts]) if parts else cloud.points

    dtype = cloud.points.dtype
    normals = None
    if cloud.normals is not None:
        mean = join(2)
        normals = (mean / mean.norm(dim=1, keepdim=True).clamp_min(1e-12)).to(dtype)
    thinned = replace(
        cloud,
        points=join(0).to(dtype),
        offsets=offsets_of(len(part[0]) for part in parts),
        colors=None if cloud.colors is None else join(1).to(dtype),
        normals=normals,
    )
    order = morton_order(thinned.points, thinned.offsets)
    return CountedVoxels(thinned.rows(order, thinned.offsets), join(3)[order])


@entry
def random_downsample(cloud: Clouds, count: int, *, generator: torch.Generator | None = None) -> Clouds:
    """Keep exactly ``count`` points of every cloud, chosen without replacement.

    Args:
        cloud: B clouds.
        count: how many points stay; a cloud with fewer keeps them all.
        generator: a CPU generator; ``None`` makes one with seed 0. One draw from it seeds the choice in every cloud,
            which so does not depend on its place in the batch. Two clouds of the same size then keep the same rows:
            for a cloud and a moved copy of it, pass generators of different seeds to two calls, or the two share
            every point.

    Returns:
        Clouds in Z order.

    Raises:
        ValueError: ``count`` below 1.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(100, 3))
        >>> len(tr.random_downsample(cloud, 10, generator=torch.Generator().manual_seed(0)).points)
        10
    """
    at_least(count, "count", 1)
    seed = draw_seed(generator)
    kept = []
    for begin, end in spans(cloud.offsets):
        if end - begin <= count:
            kept.append(torch.arange(begin, end))
            continue
        of_cloud = torch.Generator().manual_seed(seed)
        kept.append(begin + torch.randperm(end - begin, generator=of_cloud)[:count].sort().values)
    return _rows(cloud, kept)


@entry
def farthest_point_downsample(cloud: Clouds, count: int) -> Clouds:
    """Keep ``count`` points of every cloud, each the farthest from those chosen before it.

    Eldar et al., IEEE Trans. Image Processing 6(9), 1997, doi:10.1109/83.623193. The first is the point
    farthest from the cloud's mean; ties go to the lower row. Costs count x P operations.

    Args:
        cloud: B clouds.
        count: how many points stay; a cloud with fewer keeps them all.

    Returns:
        Clouds in Z order.

    Raises:
        ValueError: ``count`` below 1.

    Example:
        >>> import torch, torchreg as tr
        >>> len(tr.farthest_point_downsample(tr.Clouds(torch.rand(100, 3)), 10).points)
        10
    """
    at_least(count, "count", 1)
    kept = []
    for begin, end in spans(cloud.offsets):
        kept.append(begin + farthest_rows(cloud.points[begin:end].double(), count).cpu())
    return _rows(cloud, kept)


def draw_seed(generator: torch.Generator | None) -> int:
    """One 62-bit number from a generator (advancing it), or 0 for ``None``."""
    if generator is None:
        return 0
    expect(generator.device.type == "cpu", "generator", "a CPU generator", generator.device)
    return int(torch.randint(2**62, (1,), generator=generator).item())


def farthest_rows(points: Tensor, count: int) -> Tensor:
    """Ascending rows of ``count`` points of (P, 3) float64, each the farthest from those before it; of fewer, all."""
    if len(points) <= count:
        return torch.arange(len(points), device=points.device)
    x, y, z = (column.contiguous() for column in points.unbind(1))
    chosen = torch.empty(count, dtype=torch.int64, device=points.device)
    mx, my, mz = (column.sort().values.cumsum(0)[-1] / len(points) for column in (x, y, z))
    nearest = (x - mx).square_().add_((y - my).square_()).add_((z - mz).square_())
    current = nearest.argmax()
    nearest.fill_(float("inf"))
    for step in range(count):
        chosen[step] = current
        cx, cy, cz = (column.index_select(0, current[None]) for column in (x, y, z))  # (1,); x[current] waits for a GPU
        distance = (x - cx).square_().add_((y - cy).square_()).add_((z - cz).square_())
        torch.minimum(nearest, distance, out=nearest)
        current = nearest.argmax()
    return chosen.sort().values


def _rows(cloud: Clouds, kept: list[Tensor]) -> Clouds:
    index = torch.cat(kept) if kept else torch.zeros(0, dtype=torch.int64)
    return in_morton_order(cloud.rows(index.to(cloud.device), offsets_of(map(len, kept))))


def sizes_of_clouds(size: float | Tensor, cloud: Clouds) -> list[float]:
    """The edge of voxels of every cloud, meters, from a number or one per cloud (B,)."""
    if isinstance(size, Tensor):
        expect(size.shape == (len(cloud),), "voxel_size", f"a number or one per cloud ({len(cloud)},)", size)
        return [positive(value, "voxel_size") for value in size.tolist()]
    return [positive(size, "voxel_size")] * len(cloud)


def voxel_numbers(points: Tensor, size: float) -> tuple[Tensor, Tensor]:
    """Of points (P, 3) float64, P > 0: cells (P, 3), whole numbers, and one number (P,) int64 for each cell.

    The center of a cell is the least coordinates of the points plus ``size``, meters, times the cell.
    """
    cell = ((points - points.amin(dim=0)) / size + 0.5).floor()
    cells = cell.amax(dim=0) + 1
    expect(
        bool(torch.isfinite(cells).all()) and float(cells.prod()) < 2.0**62,
        "voxel_size",
        f"finite points and at most 2^62 voxels in the extent, {[f'{n:.3g}' for n in cells.tolist()]} along x, y, z",
        size,
    )
    grid = cell.long()
    width = cells.long()
    key = (grid[:, 2] * width[1] + grid[:, 1]) * width[0] + grid[:, 0]
    return cell, key


def _voxel_rows(cloud: Clouds, begin: int, end: int, size: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Mean points, colors and normals (float64) of the voxels of one cloud, and the numbers of their points."""
    points = cloud.points[begin:end].double()
    empty = points.new_zeros(0, 3)
    if begin == end:
        return empty, empty, empty, empty[:, 0]
    _, key = voxel_numbers(points, size)
    ordered, order = key.sort(stable=True)
    _, number, count = ordered.unique_consecutive(return_inverse=True, return_counts=True)
    divisor = count.double()[:, None]

    def mean(values: Tensor | None) -> Tensor:
        if values is None:
            return empty
        # rows of one voxel are added one after another, in their order, by a single thread
        total = torch.zeros(len(count), 3, dtype=torch.float64, device=values.device)
        total.index_add_(0, number, values[begin:end].double()[order])
        return total.div_(divisor)

    return mean(cloud.points), mean(cloud.colors), mean(cloud.normals), count.double()
