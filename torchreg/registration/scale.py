"""Options from the clouds' own scale, so that unknown data needs no tuning.

Everything is a multiple of the spacing s of the points: normals 2 s, FPFH 5 s, inlier threshold 1.5 s. The
spacing is the median distance to the fourth nearest other point. On surfaces averaged over voxels of edge v
that is v: 0.96 to 1.08 v over 50 real scans indoors and outdoors, so a cloud downsampled to 5 cm gets normals
at 10 cm, FPFH at 25 cm and a threshold of 7.5 cm.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.neighbors import neighbors
from torchreg.preprocess import voxel_downsample
from torchreg.types import Clouds, RansacOptions, RegistrationOptions

MAX_POINTS = 30_000
"""A cloud with more is thinned first."""

THINNED_POINTS = 12_000
"""What is left of the larger cloud of a pair then, at most."""

UNEVEN = 1.5
"""Clouds whose spacings differ by more than this factor are brought to the coarser one."""

_SPACING_NEIGHBOR = 4
_SPACING_SAMPLE = 20_000
_BISECTIONS = 12


def spacing(clouds: Clouds) -> Tensor:
    """The spacing of the points of every cloud.

    Args:
        clouds: B clouds.

    Returns:
        (B,) float64, meters: the median distance to the fourth nearest other point, of distinct points where most
        coincide; 0 for a cloud of fewer than 5 of them.
    """
    found = []
    for cloud in clouds.unpack():
        count = len(cloud.points)
        if count <= _SPACING_NEIGHBOR:
            found.append(torch.zeros((), dtype=torch.float64))
            continue
        # neighbors of all points, the median of an even choice of them
        reach = float((cloud.points.amax(dim=0) - cloud.points.amin(dim=0)).double().norm()) * 1.01 + 1e-30
        near = neighbors(cloud, reach, _SPACING_NEIGHBOR + 1)
        step = max(1, count // _SPACING_SAMPLE)
        median = near.sq_distance[::step, _SPACING_NEIGHBOR].double().sqrt().median().cpu()
        if float(median) == 0:  # most points stand several times
            distinct = cloud.points.unique(dim=0)
            if len(distinct) < count:
                median = spacing(Clouds(points=distinct))[0]
        found.append(median)
    return torch.stack(found) if found else torch.zeros(0, dtype=torch.float64)


def derive_options(source: Clouds, target: Clouds) -> tuple[RegistrationOptions, ...]:
    """Options for every pair, derived from the spacing of its clouds; color where both have it.

    Args:
        source: B clouds.
        target: B clouds.

    Returns:
        One ``RegistrationOptions`` per pair. ``voxel_size`` is set where a cloud has more than 30,000 points
        (the larger one keeps at most 12,000) or the spacings differ by more than a factor of 1.5.

    Raises:
        ValueError: different numbers of clouds.
    """
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    colored = source.colors is not None and target.colors is not None
    return tuple(_for_pair(one, other, colored) for one, other in zip(source.unpack(), target.unpack(), strict=True))


def scaled_options(scale: float, *, voxel_size: float | None = None, colored: bool = True) -> RegistrationOptions:
    """The default options for points ``scale`` meters apart."""
    return RegistrationOptions(
        voxel_size=voxel_size,
        normal_radius=2 * scale,
        feature_radius=5 * scale,
        color=("contrast", "pcfh") if colored else (),
        color_weights=(0.8, 0.5) if colored else (),
        color_channels=("hue", "saturation", "value"),
        equalization="none",
        color_radius=5 * scale,
        solver="compatibility",
        ransac=RansacOptions(inlier_threshold=1.5 * scale),
        effort="balanced",
    )


def _for_pair(source: Clouds, target: Clouds, colored: bool) -> RegistrationOptions:
    if not usable(source) or not usable(target):
        return scaled_options(1.0, colored=colored)  # register() refuses the pair with its reason
    voxel_size = None
    if max(len(source.points), len(target.points)) > MAX_POINTS:
        voxel_size = max(_thinning_voxel(source), _thinning_voxel(target))
        source, target = voxel_downsample(source, voxel_size), voxel_downsample(target, voxel_size)
    apart = (float(spacing(source)), float(spacing(target)))
    scale = max(apart)
    if voxel_size is None and min(apart) > 0 and scale > UNEVEN * min(apart):
        voxel_size = scale
    return scaled_options(scale if scale > 0 else 1.0, voxel_size=voxel_size, colored=colored)


def usable(cloud: Clouds) -> bool:
    """Whether one cloud has points, all of them finite."""
    return len(cloud.points) > 0 and bool(torch.isfinite(cloud.points).all())


def _thinning_voxel(cloud: Clouds) -> float:
    """The voxel edge that leaves about ``THINNED_POINTS``, not more; 0 for a cloud that has fewer."""
    if len(cloud.points) <= THINNED_POINTS:
        return 0.0
    points = cloud.points.double()
    points = points - points.amin(dim=0)
    extent = float(points.amax())
    if extent == 0:
        return 1.0
    low, high = extent / 2**20, extent
    for _ in range(_BISECTIONS):
        middle = (low * high) ** 0.5
        # cut as voxel_downsample does; at most 2^20 cells a side, so that three numbers fit into 62 bits
        grid = (points / middle + 0.5).long()
        occupied = len(torch.unique((grid[:, 0] << 42) + (grid[:, 1] << 21) + grid[:, 2]))
        low, high = (middle, high) if occupied > THINNED_POINTS else (low, middle)
    return high
