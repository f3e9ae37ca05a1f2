"""Pairs of scans with all that stays fixed while color features are varied or trained: normals, neighbors, FPFH."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.descriptors.fpfh import fpfh
from torchreg.entry import entry
from torchreg.errors import at_least, expect, expect_in_words, positive
from torchreg.neighborhoods import nearest, neighbors
from torchreg.preprocess import estimate_normals, voxel_downsample
from torchreg.types import Clouds, Features, Neighborhoods


@checked_record
@dataclass(frozen=True, eq=False)
class PreparedCloud:
    """One downsampled scan.

    Attributes:
        cloud: with normals and colors.
        near: the support of FPFH, 5 voxels and 100 nearest; color supports are restricted from it.
        fpfh: hard FPFH.

    Example:
        >>> import torchreg as tr
        >>> side = tr.learning.prepare_cloud(tr.datasets.mall(seed=1, angular_step=4.0).source, voxel=1.0)
        >>> len(side.fpfh.values) == len(side.cloud.points)
        True
    """

    cloud: Clouds
    near: Neighborhoods
    fpfh: Features


@checked_record
@dataclass(frozen=True, eq=False)
class PreparedPair:
    """Two scans of one place with their true pose.

    Attributes:
        name: of the pair.
        scene: all pairs of a scene go to training, or all to test.
        source: its downsampled scan.
        target: likewise.
        T_target_source: (4, 4) float64, meters, the true motion, origins included.
        voxel: meters; other lengths are multiples of it.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> prepared = tr.learning.prepare_pair(
        ...     pair.source, pair.target, pair.T_target_source, 1.0, name=pair.name, scene="mall"
        ... )
        >>> prepared.name
        'mall-1'
    """

    name: str
    scene: str
    source: PreparedCloud
    target: PreparedCloud
    T_target_source: Tensor
    voxel: float

    def true_partners(self, radius: float) -> tuple[Tensor, Tensor]:
        """The nearest target point of every source point under the truth, and whether it is nearer than ``radius``."""
        T = self.T_target_source
        moved = (self.source.cloud.points.double() + self.source.cloud.origin[0]) @ T[:3, :3].t() + T[:3, 3]
        target = self.target.cloud.points.double() + self.target.cloud.origin[0]
        partner = nearest(moved, target)
        return partner.index, partner.sq_distance < radius * radius


@entry
def prepare_cloud(cloud: Clouds, voxel: float) -> PreparedCloud:
    """Downsample to ``voxel`` meters and describe geometry with the paper's proportions 2 : 5.

    Raises:
        ValueError: more than one cloud, no colors, or a voxel size not above 0.

    Example:
        >>> import torchreg as tr
        >>> cloud = tr.datasets.mall(seed=1, angular_step=4.0).source
        >>> side = tr.learning.prepare_cloud(cloud, voxel=1.0)
        >>> side.fpfh.blocks
        (('fpfh', 33),)
    """
    expect(len(cloud) == 1, "cloud", "one cloud", len(cloud))
    expect_in_words(cloud.colors is not None, "cloud", "colors", "none")
    positive(voxel, "voxel")
    thinned = voxel_downsample(cloud, voxel)
    near = _support(thinned, voxel)
    oriented = estimate_normals(thinned, near.restrict(2 * voxel, 30))
    return PreparedCloud(oriented, near, fpfh(oriented, near))


@entry
def prepare_pair(
    source: Clouds, target: Clouds, T_target_source: Tensor, voxel: float, *, name: str, scene: str
) -> PreparedPair:
    """Prepare both scans of a pair; arguments as the attributes of ``PreparedPair``.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> prepared = tr.learning.prepare_pair(
        ...     pair.source, pair.target, pair.T_target_source, 1.0, name=pair.name, scene="mall"
        ... )
        >>> prepared.voxel
        1.0
    """
    expect(T_target_source.shape == (4, 4), "T_target_source", "(4, 4)", T_target_source)
    return PreparedPair(
        name,
        scene,
        prepare_cloud(source, voxel),
        prepare_cloud(target, voxel),
        T_target_source.detach().to(torch.float64),
        voxel,
    )


def cropped(pair: PreparedPair, max_points: int, generator: torch.Generator) -> PreparedPair:
    """The points of a pair nearest to one place that both scans see, to bound time and memory of training.

    A pair without more than ``max_points`` in either scan is returned unchanged. The place is drawn among the source
    points that have a partner within 2 voxels. Points at the rim see fewer neighbors than before.
    """
    at_least(max_points, "max_points", 1)
    if max(len(side.cloud.points) for side in (pair.source, pair.target)) <= max_points:
        return pair
    partner, close = pair.true_partners(2 * pair.voxel)
    shared = torch.arange(len(close), device=close.device)[close]
    if len(shared) == 0:
        return pair
    row = shared[int(torch.randint(len(shared), (), generator=generator))]
    return replace(
        pair,
        source=_around(pair.source, row, max_points, pair.voxel),
        target=_around(pair.target, partner[row], max_points, pair.voxel),
    )


def _around(side: PreparedCloud, row: Tensor, max_points: int, voxel: float) -> PreparedCloud:
    points = side.cloud.points
    distance = (points - points[row]).square().sum(dim=1)
    rows = distance.argsort(stable=True)[:max_points].sort().values
    cloud = side.cloud.rows(rows, torch.tensor([0, len(rows)]))
    geometry = replace(side.fpfh, values=side.fpfh.values[rows], valid=side.fpfh.valid[rows], offsets=cloud.offsets)
    return PreparedCloud(cloud, _support(cloud, voxel), geometry)


def _support(cloud: Clouds, voxel: float) -> Neighborhoods:
    return neighbors(cloud, 5 * voxel, 100)
