"""Poses on the scale: evidence of the clouds and agreement of the matches, put together as log-odds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.verification.agreement import Matched, agreement
from torchreg.verification.evidence import Evidence, evidence
from torchreg.verification.model import log_odds
from torchreg.verification.poses import Poses, joined
from torchreg.verification.view import View


class Scales(NamedTuple):
    """What poses of one pair are weighed on.

    Attributes:
        source: the source scan.
        target: the target scan.
        matches: the matched points of every proposal.
        threshold: meters, of an inlier.
    """

    source: View
    target: View
    matches: Sequence[Matched]
    threshold: float


class Weighed(NamedTuple):
    """H poses with what speaks for them, (H,) each.

    Attributes:
        poses: the poses.
        evidence: of the clouds.
        support: int64, inliers among the matches of the proposal that speaks loudest for the pose.
        spoken: int64, which proposal that is.
        surprise: of that support, as a power of ten.
        odds: log-odds of being right.
    """

    poses: Poses
    evidence: Evidence
    support: Tensor
    spoken: Tensor
    surprise: Tensor
    odds: Tensor

    def take(self, rows: Tensor) -> Weighed:
        """The poses ``rows`` (K,), in that order."""
        return Weighed(self.poses.take(rows), self.evidence.take(rows), *(part[rows] for part in self[2:]))

    def best_first(self) -> Weighed:
        """In order of their odds; equal ones in the order they have."""
        return self.take(self.odds.sort(descending=True, stable=True).indices)


def weigh(scales: Scales, poses: Poses) -> Weighed:
    """Put poses on the scale."""
    seen = evidence(scales.source, scales.target, poses.rotation, poses.translation, scales.threshold)
    spoken = [agreement(matched, poses.rotation, poses.translation, scales.threshold) for matched in scales.matches]
    surprises = torch.stack([each.surprise for each in spoken])  # (proposals, H)
    loudest = surprises.max(dim=0).indices
    surprise = surprises.gather(0, loudest[None])[0]
    support = torch.stack([each.support for each in spoken]).gather(0, loudest[None])[0]
    return Weighed(poses, seen, support, loudest, surprise, log_odds(seen, surprise))


def weighed_together(parts: Sequence[Weighed]) -> Weighed:
    """All poses of the parts, in order."""
    return Weighed(
        joined([part.poses for part in parts]),
        Evidence(*(torch.cat(values) for values in zip(*(part.evidence for part in parts), strict=True))),
        *(torch.cat(values) for values in zip(*(part[2:] for part in parts), strict=True)),
    )
