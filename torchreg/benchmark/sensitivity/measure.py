"""What a set of features is worth on a pair: how many of its matches are right, and whether a pose comes out."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg import metrics
from torchreg.benchmark.sensitivity.variants import Variant
from torchreg.descriptors.color import color_values, joint_color_values
from torchreg.descriptors.fuse import fuse, rooted
from torchreg.descriptors.pcfh import pcfh
from torchreg.learning.prepared import PreparedCloud, PreparedPair
from torchreg.matching import match_mutual
from torchreg.solvers.ransac import RansacOptions, ransac
from torchreg.types import Features

INLIER_VOXELS, THRESHOLD_VOXELS = 2.0, 1.5
ROTATION_BOUND, TRANSLATION_VOXELS = 15.0, 6.0
HYPOTHESES = 100_000


class Worth(NamedTuple):
    """Of features on one pair.

    Attributes:
        inlier_ratio: share of the mutual matches nearer than 2 voxels under the truth.
        found: 1 when RANSAC's pose is within 15 degrees and 6 voxels of the truth, else 0; the mean over seeds.
    """

    inlier_ratio: float
    found: float


def described(pair: PreparedPair, variant: Variant) -> tuple[Features, Features]:
    """Fused features of both scans."""
    if variant.weight == 0:
        return _rooted(pair.source.fpfh, variant.root), _rooted(pair.target.fpfh, variant.root)
    if variant.equalization == "joint":
        values = joint_color_values(pair.source.cloud, pair.target.cloud)
    else:
        source, target = pair.source.cloud, pair.target.cloud
        values = color_values(source, variant.equalization), color_values(target, variant.equalization)
    return _fused(pair.source, values[0], variant, pair.voxel), _fused(pair.target, values[1], variant, pair.voxel)


def worth(pair: PreparedPair, features: tuple[Features, Features], seeds: tuple[int, ...] = (0,)) -> Worth:
    """Match and register with these features."""
    source, target = pair.source.cloud, pair.target.cloud
    matches = match_mutual(*features)
    truth = pair.T_target_source[None]
    ratio = float(metrics.inlier_ratio(source, target, matches, truth, INLIER_VOXELS * pair.voxel))
    options = RansacOptions(hypotheses=HYPOTHESES, inlier_threshold=THRESHOLD_VOXELS * pair.voxel)
    hits = []
    for seed in seeds:
        result = ransac(source, target, matches, options, generator=torch.Generator().manual_seed(seed))
        rotation, translation = metrics.rre(truth, result.T_target_source), metrics.rte(truth, result.T_target_source)
        hits.append(float(rotation) < ROTATION_BOUND and float(translation) < TRANSLATION_VOXELS * pair.voxel)
    return Worth(ratio, sum(hits) / len(hits))


def _fused(side: PreparedCloud, values: Tensor, variant: Variant, voxel: float) -> Features:
    color = pcfh(
        side.cloud,
        side.near.restrict(variant.radius * voxel),
        bins=variant.bins,
        channels=variant.channels,
        saturation_weighting=variant.saturation_weighting,
        values=values,
    )
    return fuse(*(_rooted(block, variant.root) for block in (side.fpfh, color)), weights=(1.0, variant.weight))


def _rooted(features: Features, root: float) -> Features:
    return replace(features, values=rooted(features.values, root)) if root > 0 else features
