"""What features are worth on pairs that they were not trained on: mutual matches under the true motion, no solver.

A pair is judged as it is registered: averaged over its voxels v, normals 2 v / 30, supports 5 v / 100. A match is an
inlier where the true motion brings its points nearer than 2 v. Feature-match recall is the share of pairs with more
than 5 % inliers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import torch

from torchreg.entry import entry
from torchreg.learning.posed_pairs import DescribedSide, PosedPair, whole_view
from torchreg.matching import match_mutual
from torchreg.metrics import feature_match_recall, inlier_ratio
from torchreg.nn.network_block import NetworkBlock
from torchreg.nn.point_network import SUPPORT, PointNetwork
from torchreg.registration.options import LEARNED, RegistrationOptions
from torchreg.registration.recipes import fused_blocks
from torchreg.registration.spacing import options_for
from torchreg.types import Features

INLIER_VOXELS = 2.0

Describe = Callable[[DescribedSide, float], Features]
"""From a cloud with normals and supports, and its voxel in meters, to features ready to be matched."""


@dataclass(frozen=True)
class MatchQuality:
    """Mutual matches of one pair.

    Attributes:
        features: by which they were found.
        pair: its name.
        group: its scenes.
        matches: how many.
        inliers: how many of them are right.
        inlier_ratio: their share, 0 without matches.

    Example:
        >>> import torchreg as tr
        >>> quality = tr.learning.MatchQuality(
        ...     features="fpfh", pair="a", group="hall", matches=100, inliers=20, inlier_ratio=0.2
        ... )
        >>> quality.inliers
        20
    """

    features: str
    pair: str
    group: str
    matches: int
    inliers: int
    inlier_ratio: float


class GroupQuality(NamedTuple):
    """Means over the pairs of a group.

    Example:
        >>> import torchreg as tr
        >>> one = tr.learning.MatchQuality(
        ...     features="fpfh", pair="a", group="hall", matches=100, inliers=20, inlier_ratio=0.2
        ... )
        >>> tr.learning.by_group([one])[0].feature_match_recall
        1.0
    """

    features: str
    group: str
    pairs: int
    inlier_ratio: float
    inliers: float
    feature_match_recall: float


@entry
def match_quality(methods: dict[str, Describe], pairs: Iterable[PosedPair]) -> Iterator[MatchQuality]:
    """Judge every method on every pair, one after another, as they come. No gradients.

    Args:
        methods: from the name of features to what describes a cloud, such as ``baselines()`` and
            ``network_features(network)``.
        pairs: held out of all training.

    Example:
        >>> import torchreg as tr
        >>> scans = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> posed = tr.learning.PosedPair(scans, group="mall", voxel=1.0)
        >>> methods = {"fpfh": tr.learning.baselines()["fpfh"]}
        >>> [quality.features for quality in tr.learning.match_quality(methods, [posed])]
        ['fpfh']
    """
    return (quality for posed in pairs for quality in _qualities(methods, posed))


@entry
def _qualities(methods: dict[str, Describe], posed: PosedPair) -> list[MatchQuality]:
    """What every method makes of one pair."""
    view, qualities = whole_view(posed), []
    for name, describe in methods.items():
        with torch.no_grad():
            source, target = (describe(side, posed.voxel) for side in (view.source, view.target))
        matches = match_mutual(source, target)
        T = posed.pair.T_target_source[None]
        clouds = view.source.cloud, view.target.cloud
        share = float(inlier_ratio(*clouds, matches, T, INLIER_VOXELS * posed.voxel))
        count = len(matches.source)
        qualities.append(MatchQuality(name, posed.pair.name, posed.group, count, round(share * count), share))
    return qualities


@entry
def by_group(qualities: Sequence[MatchQuality]) -> list[GroupQuality]:
    """Means by group and features, groups in order of appearance; at last over all pairs, as the group ``"all"``.

    Example:
        >>> import torchreg as tr
        >>> one = tr.learning.MatchQuality(
        ...     features="fpfh", pair="a", group="hall", matches=100, inliers=20, inlier_ratio=0.2
        ... )
        >>> tr.learning.by_group([one])[0].inlier_ratio
        0.2
    """
    rows = []
    groups = list(dict.fromkeys(quality.group for quality in qualities))
    for group in [*groups, "all"]:
        for name in dict.fromkeys(quality.features for quality in qualities):
            some = [one for one in qualities if one.features == name and group in ("all", one.group)]
            if some:
                ratios = torch.tensor([one.inlier_ratio for one in some], dtype=torch.float64)
                inliers = sum(one.inliers for one in some) / len(some)
                recall = float(feature_match_recall(ratios))
                rows.append(GroupQuality(name, group, len(some), float(ratios.mean()), inliers, recall))
    return rows


def baselines() -> dict[str, Describe]:
    """What ships: FPFH, the default's features, and those of ``torchreg.LEARNED``; without colors, geometry alone.

    Example:
        >>> import torchreg as tr
        >>> sorted(tr.learning.baselines())
        ['LEARNED', 'default', 'fpfh']
    """
    return {
        "fpfh": lambda side, voxel: described_by(side, options_for(voxel, colored=False)),
        "default": lambda side, voxel: described_by(side, options_for(voxel)),
        "LEARNED": lambda side, voxel: described_by(side, LEARNED.scaled(voxel)),
    }


@entry
def network_features(network: PointNetwork, *, weight: float = 1.0) -> dict[str, Describe]:
    """The features of a network alone, and as a block beside the default's with a weight.

    Example:
        >>> import torchreg as tr
        >>> sorted(tr.learning.network_features(tr.nn.PointNetwork()))
        ['default + network', 'network']
    """
    return {"network": partial(_alone, network), "default + network": partial(_beside, network, weight)}


def _alone(network: PointNetwork, side: DescribedSide, voxel: float) -> Features:
    features: Features = network(side.cloud, side.near)
    return features


def _beside(network: PointNetwork, weight: float, side: DescribedSide, voxel: float) -> Features:
    return described_by(side, with_network(options_for(voxel), network, voxel, weight=weight))


def with_network(
    options: RegistrationOptions, network: PointNetwork, voxel: float, *, weight: float = 1.0
) -> RegistrationOptions:
    """The options with a network as another block, on supports of 5 voxels; ``voxel`` in meters."""
    block = NetworkBlock(network=network, radius=SUPPORT * voxel)
    return replace(options, descriptors=(*options.descriptors, block), weights=(*options.weights, weight))


def described_by(side: DescribedSide, options: RegistrationOptions) -> Features:
    """The fused features of these options, without descriptors that need colors where there are none."""
    options = options if side.cloud.colors is not None else options.without_color()
    blocks = [
        record.describe(side.cloud, side.near.restrict(record.radius, record.max_neighbors))
        for record in options.descriptors
    ]
    return fused_blocks(blocks, options.descriptors, options.weights, options.root)
