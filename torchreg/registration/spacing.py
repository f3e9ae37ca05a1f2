"""Options derived from the spacing of the points, so that unknown data needs no tuning.

Everything is a multiple of the spacing s of the points: normals 2 s, FPFH 5 s, inlier threshold 1.5 s. The
spacing is the median distance to the fourth nearest other point. On surfaces averaged over voxels of edge v
that is v: 0.96 to 1.08 v over 50 real scans indoors and outdoors, so a cloud downsampled to 5 cm gets normals
at 10 cm, FPFH at 25 cm and a threshold of 7.5 cm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import torch
from torch import Tensor

from torchreg.descriptors.contrast import Contrast
from torchreg.descriptors.fpfh import Fpfh
from torchreg.descriptors.pcfh import CHANNELS, Pcfh
from torchreg.entry import entry
from torchreg.errors import expect, one_of, positive
from torchreg.neighborhoods.search import neighbors
from torchreg.preprocess.downsample import voxel_downsample
from torchreg.registration.options import EFFORTS, RegistrationOptions
from torchreg.registration.same_clouds import same_clouds
from torchreg.solvers import CompatibilityOptions
from torchreg.types import Clouds

MAX_POINTS = 30_000
"""A cloud with more is thinned first."""

THINNED_POINTS = 12_000
"""Points that are left of the larger cloud of a pair then, at most."""

UNEVEN = 1.5
"""Clouds whose spacings differ by more than this factor are brought to the coarser one."""

COARSER = 1.5
"""By how much the derived lengths of ``effort="fast"`` exceed those of the others."""

NORMAL_SPACINGS = 2
"""The support radius of a normal, in spacings."""

_THRESHOLD_SPACINGS = 1.5  # the inlier threshold
_SPACING_NEIGHBOR = 4
_SPACING_SAMPLE = 20_000
_BISECTIONS = 12


@entry
def spacing(clouds: Clouds) -> Tensor:
    """The spacing of the points of every cloud.

    Args:
        clouds: B clouds.

    Returns:
        (B,) float64, meters: the median distance to the fourth nearest other point, of distinct points where most
        coincide; 0 for a cloud of fewer than 5 of them.

    Example:
        >>> import torch, torchreg as tr
        >>> x, y = torch.meshgrid(torch.arange(20.0), torch.arange(20.0), indexing="ij")
        >>> grid = tr.Clouds(0.1 * torch.stack([x.flatten(), y.flatten(), torch.zeros(400)], dim=1))
        >>> float(tr.spacing(grid)) < 0.15
        True
    """
    spacings = []
    for cloud in clouds.unpack():
        count = len(cloud.points)
        if count <= _SPACING_NEIGHBOR:
            spacings.append(torch.zeros((), dtype=torch.float64))
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
        spacings.append(median)
    return torch.stack(spacings) if spacings else torch.zeros(0, dtype=torch.float64)


@entry
def derive_options(source: Clouds, target: Clouds, *, effort: str = "balanced") -> tuple[RegistrationOptions, ...]:
    """Options for every pair, derived from the spacing of its clouds; color where both have it.

    Args:
        source: B clouds.
        target: B clouds. A cloud that stands several times in the batch is measured once.
        effort: as in ``RegistrationOptions``; the lengths of ``"fast"`` are half as large again.

    Returns:
        One ``RegistrationOptions`` per pair. ``voxel_size`` is set where a cloud has more than 30,000 points
        (the larger one keeps at most 12,000) or the spacings differ by more than a factor of 1.5.

    Raises:
        ValueError: different numbers of clouds, or an unknown effort.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> options, = tr.derive_options(pair.source, pair.target)
        >>> [descriptor.name for descriptor in options.descriptors]
        ['fpfh', 'contrast', 'pcfh']
    """
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    return derive_numbered(source, target, same_clouds([source, target]), effort)


def derive_numbered(
    source: Clouds, target: Clouds, numbers: Sequence[Sequence[int]], effort: str = "balanced"
) -> tuple[RegistrationOptions, ...]:
    """As ``derive_options``, for clouds that are numbered already (``same_clouds``)."""
    colored = source.colors is not None and target.colors is not None
    scales: dict[int, CloudScale] = {}
    for clouds, side in zip((source, target), numbers, strict=True):
        for number, cloud in zip(side, clouds.unpack(), strict=True):
            scales.setdefault(number, CloudScale(cloud))
    options = []
    for one, other in zip(*numbers, strict=True):
        pair = scales[one], scales[other]
        if not (usable(pair[0].cloud) and usable(pair[1].cloud)):  # register() refuses the pair, which no length helps
            options.append(options_for(1.0, colored=colored, effort=effort))
            continue
        thinned = max(scale.points for scale in pair) > MAX_POINTS
        voxel_size = max(scale.thinning_voxel for scale in pair) if thinned else None
        spacings = (pair[0].spacing(voxel_size), pair[1].spacing(voxel_size))
        options.append(options_of_spacings(spacings, voxel_size, colored=colored, effort=effort))
    return tuple(options)


class CloudScale:
    """The lengths of one cloud, each computed when it is first read.

    Attributes:
        cloud: a batch of one.
        points: how many it has.
        thinned: how many it is thinned to.
    """

    def __init__(self, cloud: Clouds, thinned: int = THINNED_POINTS) -> None:
        self.cloud, self.points, self.thinned = cloud, len(cloud.points), thinned
        self._spacings: dict[float | None, float] = {}

    @cached_property
    def thinning_voxel(self) -> float:
        """Meters; the voxel edge that leaves about ``thinned`` points, not more; 0 for a cloud that has fewer."""
        if self.points <= self.thinned:
            return 0.0
        points = self.cloud.points.double()
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
            low, high = (middle, high) if occupied > self.thinned else (low, middle)
        return high

    def spacing(self, voxel_size: float | None = None) -> float:
        """Meters, of its points or of the means over voxels of this edge."""
        if voxel_size not in self._spacings:
            cloud = self.cloud if voxel_size is None else voxel_downsample(self.cloud, voxel_size)
            self._spacings[voxel_size] = float(spacing(cloud))
        return self._spacings[voxel_size]


def options_of_spacings(
    spacings: tuple[float, float],
    voxel_size: float | None,
    *,
    scale: float | None = None,
    colored: bool = True,
    effort: str = "balanced",
) -> RegistrationOptions:
    """The options of a pair by the spacings of its clouds, source and target, after the voxels where there are any;
    meters.

    ``voxel_size`` is given where it is decided already; ``None`` sets one only where the spacings are uneven. ``scale``
    is the spacing that lengths follow; ``None`` takes the coarser one.
    """
    scale = max(spacings) if scale is None else scale
    if voxel_size is None and min(spacings) > 0 and max(spacings) > UNEVEN * min(spacings):
        voxel_size = scale
    scale = scale if scale > 0 else voxel_size or 1.0
    return options_for(scale, colored=colored, voxel_size=voxel_size, effort=effort)


@entry
def options_for(
    spacing: float, *, colored: bool = True, voxel_size: float | None = None, effort: str = "balanced"
) -> RegistrationOptions:
    """The options that ``register`` derives for points so far apart.

    Args:
        spacing: meters, the median distance of a point to its fourth nearest other one (``torchreg.spacing``).
        colored: whether both clouds of a pair have colors.
        voxel_size: meters, of the cubes that the points are averaged over first; ``None`` takes them as they are.
        effort: as in ``RegistrationOptions``. For ``"fast"`` all lengths are half as large again, and voxels thin
            the points accordingly.

    Raises:
        ValueError: a length that is not above 0, or an unknown effort.

    Example:
        >>> options_for(0.05).inlier_threshold, options_for(0.05, effort="fast").voxel_size
        (0.07500000000000001, 0.07500000000000001)
    """
    positive(spacing, "spacing")
    one_of(effort, "effort", EFFORTS)
    color = (Contrast(radius=5 * spacing), Pcfh(radius=5 * spacing, channels=CHANNELS, equalization="none"))
    options = RegistrationOptions(
        voxel_size=voxel_size,
        normal_radius=NORMAL_SPACINGS * spacing,
        descriptors=(Fpfh(radius=5 * spacing), *(color if colored else ())),
        weights=(1.0, 0.8, 0.5) if colored else (1.0,),
        solver=CompatibilityOptions(inlier_threshold=_THRESHOLD_SPACINGS * spacing),
        effort=effort,
        refine="none" if effort == "plain" else "full",
    )
    if effort != "fast":
        return options
    thinned = max(voxel_size or 0.0, options.inlier_threshold / _THRESHOLD_SPACINGS)
    return replace(options, voxel_size=thinned).scaled(COARSER)


def usable(cloud: Clouds) -> bool:
    """Whether one cloud has points, all of them finite."""
    return len(cloud.points) > 0 and bool(torch.isfinite(cloud.points).all())
