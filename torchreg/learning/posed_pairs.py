"""Pairs of scans with known motion for training a network, and views of them: changed, cropped, described anew.

A view is other every time: another motion, other points, noise, light, voxels. What it looks like follows from the
pair and a seed alone, so that training can be resumed anywhere and goes on with the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchreg.augment import AugmentPair, Compose, Illumination, Jitter, RandomMotion, RandomThin
from torchreg.augment.augmentation import uniform
from torchreg.augment.streams import derived_seed, generator_of
from torchreg.errors import expect_in_words, positive
from torchreg.geometry.se3 import apply
from torchreg.neighborhoods import nearest, neighbors
from torchreg.nn.point_network import MAX_NEIGHBORS, NORMAL_NEIGHBORS, NORMAL_SUPPORT, SUPPORT
from torchreg.preprocess import estimate_normals, voxel_downsample
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.packing import offsets_of
from torchreg.types.scan_pair import ScanPair

NORMAL_VOXELS = SUPPORT * NORMAL_SUPPORT  # a spacing of thinned scans is a voxel
_BASE_VOXELS = 0.6  # of the pair, to which scans are thinned once


@dataclass(frozen=True, eq=False)
class PosedPair:
    """Two scans of one place and their true motion.

    Attributes:
        pair: the scans and the motion.
        group: where it was scanned: all pairs of a group go to training, or all are held out.
        voxel: meters; all other lengths are multiples of it.

    Raises:
        ValueError: no known motion, or a voxel not above 0.

    Example:
        >>> import torchreg as tr
        >>> posed = tr.learning.PosedPair(tr.datasets.mall(seed=1, angular_step=4.0), group="mall", voxel=0.5)
        >>> posed.pair.name
        'mall-1'
    """

    pair: ScanPair
    group: str
    voxel: float

    def __post_init__(self) -> None:
        positive(self.voxel, "voxel")
        expect_in_words(self.pair.has_truth, "pair", "a known motion", f"{self.pair.name} without")

    def thinned(self) -> PosedPair:
        """The same pair with no more points than views need: averaged over 0.6 voxels."""
        edge = _BASE_VOXELS * self.voxel
        source, target = (voxel_downsample(cloud, edge) for cloud in (self.pair.source, self.pair.target))
        return replace(self, pair=replace(self.pair, source=source, target=target))


@dataclass(frozen=True, eq=False)
class DescribedSide:
    """A cloud with normals, and the support of every point."""

    cloud: Clouds
    near: Neighborhoods


@dataclass(frozen=True, eq=False)
class PairView:
    """Two clouds as a network sees them, and which points are the same places.

    Attributes:
        source: P points, averaged over voxels, with normals.
        target: likewise, Q points.
        partner: (P,) int64, the nearest target row under the true motion.
        is_partner: (P,) bool, whether it is near enough to be the same place.
        voxel: meters.
    """

    source: DescribedSide
    target: DescribedSide
    partner: Tensor
    is_partner: Tensor
    voxel: float


def whole_view(posed: PosedPair, partner_voxels: float = 1.0) -> PairView:
    """The pair as it is, averaged over its voxels: what is judged."""
    return _viewed(posed.pair, posed.voxel, partner_voxels)


def random_view(posed: PosedPair, seed: int, *, points: int, partner_voxels: float = 1.0) -> PairView:
    """A part of a changed pair, around a place that both scans see, of about so many points a side.

    Changed are motion (any), density, noise, light and color, the size of voxels (0.85 to 1.3), and in one view of
    five, colors are dropped.
    """
    draw = generator_of(derived_seed(seed, "view"))
    voxel = posed.voxel * uniform(0.85, 1.3, draw)
    pair = _cropped(posed.pair, posed.voxel, points, draw)
    change = Compose(
        RandomMotion(),
        RandomThin(keep=(0.5, 1.0), probability=0.3),
        Jitter(sigma=uniform(0.0, 0.15, draw) * posed.voxel),
        Illumination(white_balance=0.2, exposure=0.5, gamma=1.2, hue=0.02, probability=0.5),
    )
    pair = AugmentPair(change, generator=draw)(pair)
    if uniform(0.0, 1.0, draw) < 0.2:
        source, target = (replace(cloud, colors=None) for cloud in (pair.source, pair.target))
        pair = replace(pair, source=source, target=target)
    return _viewed(pair, voxel, partner_voxels)


def _viewed(pair: ScanPair, voxel: float, partner_voxels: float) -> PairView:
    source, target = (_side(voxel_downsample(cloud, voxel), voxel) for cloud in (pair.source, pair.target))
    partner = nearest(_moved(pair, source.cloud), _placed(target.cloud))
    is_partner = partner.sq_distance < (partner_voxels * voxel) ** 2
    return PairView(source, target, partner.index, is_partner, voxel)


def _side(cloud: Clouds, voxel: float) -> DescribedSide:
    near = neighbors(cloud, SUPPORT * voxel, MAX_NEIGHBORS)
    return DescribedSide(estimate_normals(cloud, near.restrict(NORMAL_VOXELS * voxel, NORMAL_NEIGHBORS)), near)


def _cropped(pair: ScanPair, voxel: float, count: int, draw: torch.Generator) -> ScanPair:
    """The points of both scans nearest to one place that both see, where there is one: so many once averaged."""
    partner = nearest(_moved(pair, pair.source), _placed(pair.target))
    shared = (partner.sq_distance < (2 * voxel) ** 2).nonzero()[:, 0]
    if len(shared) == 0:
        return pair
    row = shared[int(torch.randint(len(shared), (1,), generator=draw))]
    source, target = _around(pair.source, row, voxel, count), _around(pair.target, partner.index[row], voxel, count)
    return replace(pair, source=source, target=target, information=None)


def _around(cloud: Clouds, row: Tensor, voxel: float, count: int) -> Clouds:
    averaged = len(voxel_downsample(cloud, voxel).points)
    if averaged <= count:
        return cloud
    distance = (cloud.points - cloud.points[row]).square().sum(dim=1)
    rows = distance.argsort(stable=True)[: count * len(distance) // averaged].sort().values
    return cloud.rows(rows, offsets_of([len(rows)]))


def _placed(cloud: Clouds) -> Tensor:
    """Points (P, 3) float64 in the frame of the file."""
    return cloud.points.double() + cloud.origin[0]


def _moved(pair: ScanPair, source: Clouds) -> Tensor:
    """Points of the source under the true motion, (P, 3) float64."""
    return apply(pair.T_target_source, _placed(source))
