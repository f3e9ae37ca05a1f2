"""What a solver hands back for one pair, and a pair's poses in the frames of its clouds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.solvers.group import Group
from torchreg.solvers.proposals import Proposals
from torchreg.solvers.refine import Scored
from torchreg.types import Failure


class Found(NamedTuple):
    """The outcome of a solver.

    Attributes:
        proposals: hypotheses with their proposed counts; ``None`` when there is none.
        drawn: hypotheses begun: samples drawn, or seeds.
        kept: those that passed the first test: of edge lengths, or of having partners enough.
        scored: poses scored on all correspondences.
        failure: why there is no hypothesis, else ``None``.
    """

    proposals: Proposals | None
    drawn: int
    kept: int
    scored: int
    failure: Failure | None


class PairPoses(NamedTuple):
    """The poses of one pair, best first and distinct; H = 0 beside a failure.

    A pose takes ``source.points`` to ``target.points``: x_target = R x_source + t, origins left out.

    Attributes:
        rotation: (H, 3, 3) float64.
        translation: (H, 3) float64, meters.
        inliers: (H, M) bool over the pair's correspondences.
        support: (H,) int64, number of inliers.
        error: (H,) float64, sum of squared residuals of the inliers, square meters.
        drawn: hypotheses begun.
        kept: those that passed the first test.
        scored: poses scored on all correspondences.
        failure: why there is no pose, else ``None``.
    """

    rotation: Tensor
    translation: Tensor
    inliers: Tensor
    support: Tensor
    error: Tensor
    drawn: int
    kept: int
    scored: int
    failure: Failure | None


def no_pose(found: Found, matches: int, device: torch.device) -> PairPoses:
    """Of a pair with so many matches and no hypothesis."""
    empty = torch.zeros(0, dtype=torch.float64, device=device)
    inliers = torch.zeros(0, matches, dtype=torch.bool, device=device)
    return PairPoses(empty.reshape(0, 3, 3), empty.reshape(0, 3), inliers, empty.long(), empty, *found[1:])


def pair_poses(scored: Scored, group: Group, found: Sequence[Found]) -> Iterator[PairPoses]:
    """The poses of every pair of a group, from hypotheses pair by pair about the means of the points."""
    R = scored.rotation.permute(2, 0, 1).contiguous()  # (H, 3, 3)
    t = scored.translation.t() + group.target_center[scored.pair]
    t = t - apply_rotation(R, group.source_center[scored.pair])
    lengths = torch.bincount(scored.pair, minlength=len(found)).tolist()
    rotations, translations, inliers, supports, errors = (
        part.split(lengths) for part in (R, t, scored.inliers, scored.support, scored.error)
    )
    for place, (matches, outcome) in enumerate(zip(group.points.counts, found, strict=True)):
        inside = inliers[place][:, :matches].contiguous()
        yield PairPoses(rotations[place], translations[place], inside, supports[place], errors[place], *outcome[1:])
