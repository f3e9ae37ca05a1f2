"""Cheap signs that two scans overlap: how far a few hundred matches between them agree about lengths.

Registering a pair takes a good part of a second; most pairs of a large site have nothing in common. So of every scan a
sketch is kept, some points with their features. The matches between two sketches are few, but where scans overlap, a
group of them keeps all lengths among themselves; where they do not, they agree by chance alone. The votes of a pair
are how far the best supported match stands out of that chance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import lane_sums
from torchreg.matching import match_mutual
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.recipes import fused, recipes_of
from torchreg.solvers.compatibility.graph import first_order, second_order
from torchreg.types import Features

POINTS = 1000
"""Of a sketch at most."""

_REACH = 2.0  # inlier thresholds by which lengths may differ: points of sketches hardly ever correspond exactly
_LEAST = 8  # matches


class Sketch(NamedTuple):
    """Some points of a described scan.

    Attributes:
        points: (K, 3) float64, meters, in the frame of the scan's file.
        features: (K, D), fused as they are matched, all valid.
        spacing: meters, between neighboring points of the sketch, about.
    """

    points: Tensor
    features: Tensor
    spacing: float


def sketch_of(described: DescribedClouds, options: RegistrationOptions, *, colored: bool) -> Sketch:
    """The sketch of one described scan: points evenly chosen along their Z order, among those with features."""
    features = fused(described, recipes_of(options, colored=colored)[0], options)
    rows = features.valid.nonzero()[:, 0]
    step = max(1, -(-len(rows) // POINTS))
    rows = rows[::step]
    points = described.cloud.points[rows].double() + described.cloud.origin[0]
    return Sketch(points.cpu(), features.values[rows].cpu(), described.spacing[0] * math.sqrt(step))


def votes(one: Sketch, other: Sketch, threshold: float) -> float:
    """How far the matches between two sketches agree beyond chance, in deviations; 0 where too few match.

    ``threshold`` is the inlier threshold of the pair in meters.
    """
    matches = match_mutual(_alone(one.features), _alone(other.features))
    count = len(matches.source)
    if count < _LEAST:
        return 0.0
    source, target = one.points[matches.source].t().contiguous(), other.points[matches.target].t().contiguous()
    graph = first_order(source, target, _REACH * threshold)
    # lengths near zero are alike in any two places
    chance = float(lane_sums(graph.sum(dim=0).double(), dim=0)) / (count * (count - 1))
    common = second_order(graph).sum(dim=0)
    # of a match by chance: partners, each with the common partners that two of them have
    partners = (count - 1) * chance
    expected = partners * (count - 2) * chance**2
    return (float(common.max()) - expected) / math.sqrt(expected + 1.0)


def _alone(features: Tensor) -> Features:
    offsets = torch.tensor([0, len(features)])
    return Features(features, offsets, (("fused", features.shape[1]),), torch.ones(len(features), dtype=torch.bool))
