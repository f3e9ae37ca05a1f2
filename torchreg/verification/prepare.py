"""Pairs made ready for the verdict: clouds about their middles in float32, matches, poses between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.solvers import PairPoses
from torchreg.types import Clouds, Correspondences
from torchreg.types.packing import spans
from torchreg.verification.agreement import Matched, places
from torchreg.verification.care import Lengths
from torchreg.verification.poses import Poses, joined
from torchreg.verification.side import in_step
from torchreg.verification.view import view
from torchreg.verification.weigh import Scales


class Ready(NamedTuple):
    """One pair.

    Attributes:
        source: one cloud about its middle; its origin takes the middle up.
        target: likewise.
        matched: of every proposal, between those frames.
        poses: of all proposals, between those frames.
        lengths: meters.
    """

    source: Clouds
    target: Clouds
    matched: Sequence[Matched]
    poses: Poses
    lengths: Lengths


def ready(
    source: Clouds, target: Clouds, matched: Sequence[Matched], found: Sequence[PairPoses], lengths: Lengths, most: int
) -> Ready:
    """One pair, clouds of a batch of one each, with the matches and at most so many poses of every proposal."""
    one, center_one = _centered(source)
    other, center_other = _centered(target)
    parts = []
    for number, pair in enumerate(found):
        moved = apply_rotation(pair.rotation, center_one.expand_as(pair.translation))
        origin = torch.full_like(pair.support, number)
        poses = Poses(pair.rotation, pair.translation + moved - center_other, origin, torch.zeros_like(origin))
        parts.append(poses.take(slice(most)))
    return Ready(
        source=one,
        target=other,
        matched=[Matched(each.source - center_one, each.target - center_other) for each in matched],
        poses=joined(parts),
        lengths=lengths,
    )


def matched_points(source: Clouds, target: Clouds, matches: Correspondences) -> list[Matched]:
    """Of every pair of a batch, in float64."""
    p, q = source.points[matches.source].double(), target.points[matches.target].double()
    return [Matched(p[begin:end], q[begin:end]) for begin, end in spans(matches.offsets)]


def scales_of(pairs: Sequence[Ready], sample: int) -> Scales:
    """What the poses of G pairs are weighed on, ``sample`` points of each scan."""
    thresholds = [pair.lengths.threshold for pair in pairs]
    threshold = torch.tensor(thresholds, dtype=torch.float64, device=pairs[0].source.device)
    sides = [
        in_step(
            [view(cloud, pair.lengths.spacing, sample) for cloud, pair in zip(clouds, pairs, strict=True)], threshold
        )
        for clouds in ([pair.source for pair in pairs], [pair.target for pair in pairs])
    ]
    return Scales(
        source=sides[0],
        target=sides[1],
        matches=[[places(part, pair.lengths.threshold) for part in pair.matched] for pair in pairs],
        threshold=threshold,
    )


def poses_of(pairs: Sequence[Ready]) -> Poses:
    """The poses of G pairs, pair by pair."""
    return joined(
        [pair.poses._replace(pair=torch.full_like(pair.poses.pair, number)) for number, pair in enumerate(pairs)]
    )


def _centered(cloud: Clouds) -> tuple[Clouds, Tensor]:
    """One cloud about its middle (3,) float64, in float32, which then loses nothing; the origin takes the middle up."""
    wide = cloud.points.double()
    center = (wide.amin(dim=0) + wide.amax(dim=0)) / 2
    viewpoint = None if cloud.viewpoint is None else (cloud.viewpoint.double() - center).float()
    moved = Clouds(
        points=(wide - center).float(),
        colors=None if cloud.colors is None else cloud.colors.float(),
        normals=None if cloud.normals is None else cloud.normals.float(),
        origin=cloud.origin + center,
        viewpoint=viewpoint,
    )
    return moved, center
