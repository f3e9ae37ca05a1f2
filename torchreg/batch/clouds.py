"""A cloud of a batch: where it is, how it is read, and its measures."""

from __future__ import annotations

from typing import NamedTuple

import torch

from torchreg.batch.pairs import Pair
from torchreg.io import read_cloud_report
from torchreg.preprocess import random_downsample
from torchreg.registration.inspect import facts_of, too_wide
from torchreg.registration.same_clouds import digest_of
from torchreg.registration.spacing import MAX_POINTS, CloudScale
from torchreg.seeds import torch_seed
from torchreg.settings import StageSettings
from torchreg.types import Clouds


class CloudSource(NamedTuple):
    """A file and how it is read; equal ones give equal clouds."""

    path: str
    viewpoint: str  # as in ``PairSettings``
    points: int | None  # that are chosen at random; ``None`` for all
    seed: int  # of that choice; 0 where there is none
    scan: str | None = None  # likewise as in ``PairSettings``, and so are the next
    columns: str | None = None
    units: str | None = None
    intensity: bool = False
    finest: float | None = None  # meters, the voxel edge that was given: large files are thinned for it


class CloudMeasures(NamedTuple):
    """What is known of a cloud before it is described."""

    digest: str  # of all that the cloud holds; equal clouds have equal digests
    points: int
    colored: bool
    voxel: float  # meters; the voxel edge that its number of points asks for, or that was given; 0 for none
    spacing: float  # meters, of the points after that; 0 where it was not asked for


def sources_of(pair: Pair) -> tuple[CloudSource, CloudSource]:
    """Source and target of a pair."""
    given = pair.settings
    seed = given.seed if given.points is not None else 0
    how = (given.columns, given.units, given.intensity, given.voxel)
    sides = zip((pair.source, pair.target), given.scans(), strict=True)
    source, target = (CloudSource(path, given.viewpoint, given.points, seed, scan, *how) for path, scan in sides)
    return source, target


def read_source(source: CloudSource) -> Clouds:
    """Read a cloud, a batch of one on the CPU.

    Raises:
        CloudFileError: the file is missing or damaged.
    """
    settings = StageSettings(
        viewpoint=source.viewpoint,
        columns=source.columns,
        units=source.units,
        intensity=source.intensity,
        voxel=source.finest,
    )
    cloud = read_cloud_report(source.path, scan=source.scan, reading=settings.reading()).cloud
    if source.points is None:
        return cloud
    # points are chosen once for all pairs of a cloud; from a copy of it that was moved, others are chosen
    seed = int(digest_of(cloud)[:12], 16) ^ torch_seed(source.seed)
    return random_downsample(cloud, source.points, generator=torch.Generator().manual_seed(seed))


def measure(cloud: Clouds, voxel: float | None, *, scaled: bool) -> CloudMeasures:
    """Measure a cloud.

    Args:
        cloud: a batch of one.
        voxel: meters, the voxel edge that was given; ``None`` where its number of points decides.
        scaled: whether the spacing is asked for.
    """
    scale, facts = CloudScale(cloud), facts_of(cloud)[0]
    edge = voxel or 0.0
    if voxel is not None:
        scaled = scaled and not too_wide(facts, voxel)
    scaled = scaled and not facts.defect  # its pairs will be refused, with their reason
    if scaled and voxel is None and scale.points > MAX_POINTS:
        edge = scale.thinning_voxel
    spacing = scale.spacing(edge or None) if scaled else 0.0
    return CloudMeasures(digest_of(cloud), scale.points, cloud.colors is not None, edge, spacing)
