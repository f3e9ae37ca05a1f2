"""A second look at pairs in doubt: other scales, other supports, other signs of the normals.

The first look describes points at one support radius, on normals turned to the viewpoint or towards the middle. Where
no pose of it convinces, the same pair is seen in other ways: points twice as far apart, whose descriptors reach twice
as far and of which there are a quarter, so that the whole costs little; supports of 3 and 8 spacings beside that of
the options; and, where the place of a scanner is not known, normals that agree along surfaces, in both of the signs
that they may have to those of the other cloud. All these poses then compete with those of the first look.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch

from torchreg.descriptors.descriptor import Descriptor
from torchreg.matching.mutual import match_mutual
from torchreg.neighborhoods.point_index import nearest
from torchreg.neighborhoods.search import neighbors
from torchreg.preprocess.downsample import voxel_downsample
from torchreg.preprocess.normals import estimate_normals
from torchreg.preprocess.orientation import orient_along_surfaces
from torchreg.registration.describe import features_of, select
from torchreg.registration.described import DescribedClouds
from torchreg.registration.inspect import too_wide
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.recipes import fused_blocks
from torchreg.solvers.batch import poses_of_pairs
from torchreg.types import Clouds, Features
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


def second_look(
    source: DescribedClouds,
    target: DescribedClouds,
    options: RegistrationOptions,
    seed: int,
    before: Collection[str] = (),
) -> list[ProposedPoses]:
    """The poses of one pair, seen in other ways; their matches are rows of its clouds.

    Args:
        source: one cloud.
        target: one cloud.
        options: of the pair. Descriptors that look at both clouds of a pair are left out.
        seed: of every random draw, as the solvers take it.
        before: origins of proposals that there are already, which are not made again.

    Returns:
        One proposal per way; none where no descriptor is left, none coarser where points are too far apart for voxels.
    """
    colored = source.cloud.colors is not None and target.cloud.colors is not None
    blocks = [
        block
        for block in zip(options.descriptors, options.weights, strict=True)
        if (colored or not block[0].needs_colors) and not block[0].is_pairwise
    ]
    known = bool(source.cloud.viewpoint_known[0]) and bool(target.cloud.viewpoint_known[0])
    proposed = []
    for coarser in (1.0, COARSER):
        ways = [way for way in (_SEEN if known else _SEEN + _UNSEEN) if way.coarser == coarser]
        chosen = [(way, _blocks_of(way, blocks)) for way in ways]
        chosen = [(way, of_way) for way, of_way in chosen if of_way and _origin(way, of_way, options) not in before]
        voxel = None if coarser == 1 else _voxel(options, coarser)
        if chosen and not any(too_wide(facts, voxel) for facts in (*source.facts, *target.facts)):
            records = [_wider(record, way) for way, of_way in chosen for record, _ in of_way]
            one, other = (_Side(side, options, records, coarser) for side in (source, target))
            proposed += [_proposed(one, other, way, of_way, options, seed) for way, of_way in chosen]
    return proposed


def _voxel(options: RegistrationOptions, coarser: float) -> float:
    """Meters, the edge of voxels that leave points so many times as far apart as the options have them."""
    return coarser * _SPACING * options.inlier_threshold


_Block = tuple[Descriptor, float]
"""A descriptor of the options and its weight."""


class _Side:
    """One cloud at one spacing; what several ways share is computed once.

    Attributes:
        rows: (P,) of the described cloud, the nearest of its points.
        keypoints: (P,) bool, the points that are matched; ``None`` where all are.
    """

    def __init__(
        self, side: DescribedClouds, options: RegistrationOptions, records: Sequence[Descriptor], coarser: float
    ) -> None:
        described, rule = side.cloud, None if options.keypoints is None else options.keypoints.scaled(coarser)
        normal_radius, normal_neighbors = coarser * options.normal_radius, options.normal_max_neighbors
        radius = max(normal_radius, *(record.radius for record in records))
        most = max(normal_neighbors, *(record.max_neighbors for record in records))
        if rule is not None and rule.support is not None:
            radius, most = max(radius, rule.support.radius), max(most, rule.support.max_neighbors)
        cloud = described
        if coarser != 1:
            cloud = voxel_downsample(replace(described, normals=None), _voxel(options, coarser))
        self._near = neighbors(cloud, radius, most)
        self.rows = torch.arange(len(cloud.points), device=cloud.device)
        if coarser != 1:
            cloud = estimate_normals(cloud, self._near.restrict(normal_radius, normal_neighbors))
            self.rows = nearest(cloud.points, described.points).index
        self.keypoints = side.keypoints if coarser == 1 else select(cloud, self._near, [rule])
        self._clouds = {"viewpoint": cloud}
        self._features: dict[tuple[Descriptor, str], Features] = {}

    def cloud(self, signs: str = "viewpoint") -> Clouds:
        """With normals turned to the viewpoint, or with signs that agree along surfaces, or the opposite ones."""
        if signs not in self._clouds:
            if signs == "surfaces":
                self._clouds[signs] = orient_along_surfaces(self._clouds["viewpoint"], self._near)
            else:
                turned = self.cloud("surfaces")
                self._clouds[signs] = replace(turned, normals=None if turned.normals is None else -turned.normals)
        return self._clouds[signs]

    def features(self, record: Descriptor, signs: str) -> Features:
        """Of every point, by one descriptor."""
        if (record, signs) not in self._features:
            self._features[record, signs] = features_of(self.cloud(signs), self._near, [[record]])[0]
        return self._features[record, signs]


def _blocks_of(way: Way, blocks: Sequence[_Block]) -> list[_Block]:
    """The descriptors of a way; none where it would be the same as another."""
    geometry = [block for block in blocks if not block[0].needs_colors]
    if not way.geometry:
        return list(blocks)
    return geometry if len(geometry) < len(blocks) else []


def _wider(record: Descriptor, way: Way) -> Descriptor:
    """The descriptor at the scale and the support of a way; as many more neighbors as a wider disk holds."""
    neighbors = math.ceil(record.max_neighbors * max(1.0, way.support) ** 2)
    return replace(scaled(record, way.coarser * way.support), max_neighbors=neighbors)


def _origin(way: Way, blocks: Sequence[_Block], options: RegistrationOptions) -> str:
    """The way in words, as ``Recipe.origin``."""
    names = " + ".join(record.name for record, _ in blocks)
    return f"{names}{way.words}, {_NEAREST} nearest, {options.solver.name}"


def _proposed(
    source: _Side, target: _Side, way: Way, blocks: Sequence[_Block], options: RegistrationOptions, seed: int
) -> ProposedPoses:
    """Describe, match and solve in one way."""
    records, weights = zip(*blocks, strict=True)
    signs = (way.signs if way.signs == "viewpoint" else "surfaces", way.signs)
    fused = []
    for side, sign in zip((source, target), signs, strict=True):
        features = [side.features(_wider(record, way), sign) for record in records]
        every = fused_blocks(features, records, weights, options.root)
        fused.append(every if side.keypoints is None else replace(every, valid=every.valid & side.keypoints))
    matches = match_mutual(*fused, neighbors=_NEAREST)
    solver = options.solver.scaled(way.coarser).at_effort(options.effort)
    poses = poses_of_pairs(source.cloud(), target.cloud(), matches, [solver], seed=seed)
    rows = replace(matches, source=source.rows[matches.source], target=target.rows[matches.target])
    return ProposedPoses(_origin(way, blocks, options), rows, poses, way.coarser)
