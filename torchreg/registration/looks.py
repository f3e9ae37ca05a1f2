"""A second look at pairs in doubt: other scales, other supports, other signs of the normals.

The first look describes points at one support radius, on normals turned to the viewpoint or towards the middle. Where
no pose of it convinces, the same pair is seen in other ways: points twice as far apart, whose descriptors reach twice
as far and of which there are a quarter, so that the whole costs little; supports of 3 and 8 spacings beside that of
the options; and, where the place of a scanner is not known, normals that agree along surfaces, in both of the signs
that they may have to those of the other cloud. All these poses then compete with those of the first look.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.descriptor import Descriptor
from torchreg.matching.mutual import match_mutual
from torchreg.neighborhoods.point_index import nearest
from torchreg.neighborhoods.search import neighbors
from torchreg.preprocess.downsample import voxel_downsample
from torchreg.preprocess.normals import estimate_normals
from torchreg.preprocess.orientation import orient_along_surfaces
from torchreg.registration.describe import description_of, features_of
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.recipes import fused_blocks
from torchreg.solvers.batch import poses_of_pairs
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.lengths import scaled
from torchreg.verification import ProposedPoses

COARSER = 2.0
"""How many times as far apart the points of the coarse look are."""

_SPACING = 1 / 1.5  # of the points, in inlier thresholds
_NEAREST = 2  # rows that may match


class Way(NamedTuple):
    """One way to see a pair."""

    coarser: float  # how many times as far apart its points are
    support: float  # the support radius of descriptors, in those of the options
    geometry: bool  # by the descriptors that need no colors, alone
    signs: str  # of normals: "viewpoint", "surfaces", "opposite" (the target's against those of its surfaces)

    @property
    def words(self) -> str:
        """What is other than at the first look."""
        signs = {"viewpoint": "", "surfaces": ", signs along surfaces", "opposite": ", opposite signs"}[self.signs]
        scale = f", points {self.coarser:g} times as far apart" if self.coarser != 1 else ""
        support = f", support {self.support:g} times as wide" if self.support != 1 else ""
        return f"{scale}{support}{signs}"


_SEEN = (
    Way(1.0, 1.0, True, "viewpoint"),
    Way(1.0, 0.6, False, "viewpoint"),
    Way(COARSER, 0.6, False, "viewpoint"),
    Way(COARSER, 1.0, False, "viewpoint"),
    Way(COARSER, 1.0, True, "viewpoint"),
    Way(COARSER, 1.6, False, "viewpoint"),
)
_UNSEEN = (
    Way(1.0, 1.0, False, "surfaces"),
    Way(1.0, 1.0, False, "opposite"),
    Way(COARSER, 1.0, False, "surfaces"),
    Way(COARSER, 1.0, False, "opposite"),
    Way(COARSER, 1.6, False, "surfaces"),
)


class _Side(NamedTuple):
    """One cloud at one spacing."""

    cloud: Clouds  # with normals turned to the viewpoint
    near: Neighborhoods  # as wide as the widest support
    rows: Tensor  # (P,) of the described cloud, the nearest of its points


def second_look(
    source: DescribedClouds, target: DescribedClouds, options: RegistrationOptions, seed: int
) -> list[ProposedPoses]:
    """The poses of one pair, seen in other ways; their matches are rows of its clouds.

    Args:
        source: one cloud.
        target: one cloud.
        options: of the pair. Descriptors that look at both clouds of a pair are left out.
        seed: of every random draw, as the solvers take it.

    Returns:
        One proposal per way; none where no descriptor is left.
    """
    colored = source.cloud.colors is not None and target.cloud.colors is not None
    records = [record for record in description_of(options, colored=colored).descriptors if not record.is_pairwise]
    known = bool(source.cloud.viewpoint_known[0]) and bool(target.cloud.viewpoint_known[0])
    proposed = []
    for coarser in (1.0, COARSER):
        ways = [way for way in (_SEEN if known else _SEEN + _UNSEEN) if way.coarser == coarser]
        sides = [_side(side.cloud, options, records, ways) for side in (source, target)]
        for way in ways:
            chosen = _descriptors(records, way)
            if chosen:
                proposed.append(_proposed(sides, way, chosen, options, seed))
    return proposed


def _side(described: Clouds, options: RegistrationOptions, records: Sequence[Descriptor], ways: Sequence[Way]) -> _Side:
    """One cloud at the spacing of the ways, which is the same for all of them."""
    coarser = ways[0].coarser
    wider = [_wider(record, way) for record in records for way in ways]
    radius = max(coarser * options.normal_radius, *(record.radius for record in wider))
    most = max(options.normal_max_neighbors, *(record.max_neighbors for record in wider))
    cloud = described
    if coarser != 1:
        cloud = voxel_downsample(replace(described, normals=None), coarser * _SPACING * options.inlier_threshold)
    near = neighbors(cloud, radius, most)
    if coarser != 1:
        cloud = estimate_normals(cloud, near.restrict(coarser * options.normal_radius, options.normal_max_neighbors))
    rows = nearest(cloud.points, described.points).index if coarser != 1 else torch.arange(len(cloud.points))
    return _Side(cloud, near, rows.to(cloud.device))


def _wider(record: Descriptor, way: Way) -> Descriptor:
    """The descriptor at the scale and the support of a way; as many more neighbors as a wider disk holds."""
    neighbors = math.ceil(record.max_neighbors * max(1.0, way.support) ** 2)
    return replace(scaled(record, way.coarser * way.support), max_neighbors=neighbors)


def _descriptors(records: Sequence[Descriptor], way: Way) -> list[int]:
    """The numbers of the descriptors of a way; none where it would be the same as another."""
    geometry = [number for number, record in enumerate(records) if not record.needs_colors]
    if not way.geometry:
        return list(range(len(records)))
    return geometry if len(geometry) < len(records) else []


def _proposed(
    sides: Sequence[_Side], way: Way, chosen: Sequence[int], options: RegistrationOptions, seed: int
) -> ProposedPoses:
    """Describe, match and solve in one way."""
    colored = all(side.cloud.colors is not None for side in sides)
    kept = [
        (record, weight)
        for record, weight in zip(options.descriptors, options.weights, strict=True)
        if (colored or not record.needs_colors) and not record.is_pairwise
    ]
    records, weights = zip(*(kept[number] for number in chosen), strict=True)
    fused = []
    for role, side in enumerate(sides):
        cloud = _signed(side, way.signs, opposite=role == 1)
        features = features_of(cloud, side.near, [[_wider(record, way) for record in records]])
        fused.append(fused_blocks(features, records, weights, options.root))
    matches = match_mutual(*fused, neighbors=_NEAREST)
    solver = options.solver.scaled(way.coarser).at_effort(options.effort)
    poses = poses_of_pairs(sides[0].cloud, sides[1].cloud, matches, [solver], seed=seed)
    rows = replace(matches, source=sides[0].rows[matches.source], target=sides[1].rows[matches.target])
    names = " + ".join(record.name for record in records)
    return ProposedPoses(f"{names}{way.words}, {_NEAREST} nearest, {solver.name}", rows, poses, way.coarser)


def _signed(side: _Side, signs: str, *, opposite: bool) -> Clouds:
    """The cloud with the signs of its normals that a way asks for."""
    if signs == "viewpoint":
        return side.cloud
    cloud = orient_along_surfaces(side.cloud, side.near)
    if signs == "opposite" and opposite and cloud.normals is not None:
        return replace(cloud, normals=-cloud.normals)
    return cloud
