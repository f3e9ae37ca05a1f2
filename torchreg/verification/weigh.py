"""Poses on the scale: evidence of the clouds and agreement of the matches, put together as log-odds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.verification.agreement import Places, agreement
from torchreg.verification.evidence import Evidence, evidence
from torchreg.verification.model import log_odds
from torchreg.verification.poses import Poses, joined, runs_of
from torchreg.verification.side import Side


class Scales(NamedTuple):
    """What poses of G pairs are weighed on.

    Attributes:
        source: the source scans.
        target: the target scans.
        matches: of every pair, the matched points of every proposal.
        threshold: (G,) float64, meters, of an inlier.
    """

    source: Side
    target: Side
    matches: Sequence[Sequence[Places]]
    threshold: Tensor


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

    def take(self, rows: Tensor | slice) -> Weighed:
        """The poses ``rows`` (K,), in that order."""
        return Weighed(self.poses.take(rows), self.evidence.take(rows), *(part[rows] for part in self[2:]))

    def best_first(self) -> Weighed:
        """Pair by pair in order of their odds; equal ones in the order they have."""
        order = self.odds.sort(descending=True, stable=True).indices
        return self.take(order[self.poses.pair[order].sort(stable=True).indices])


def weigh(scales: Scales, poses: Poses) -> Weighed:
    """Put poses, those of each pair together, on the scale."""
    seen = evidence(scales.source, scales.target, poses.pair, poses.rotation, poses.translation, scales.threshold)
    runs = runs_of(poses.pair)
    supports, surprises = [], []
    for number in range(len(scales.matches[0])):
        told = [
            agreement(scales.matches[pair][number], poses.rotation[begin:end], poses.translation[begin:end])
            for pair, begin, end in runs
        ]
        supports.append(torch.cat([each.support for each in told]))
        surprises.append(torch.cat([each.surprise for each in told]))
    loudness = torch.stack(surprises)  # (proposals, H)
    loudest = loudness.max(dim=0).indices
    surprise = loudness.gather(0, loudest[None])[0]
    support = torch.stack(supports).gather(0, loudest[None])[0]
    # pair by pair, since logarithms round differently at the end of a range
    odds = [log_odds(seen.take(slice(begin, end)), surprise[begin:end]) for _, begin, end in runs]
    return Weighed(poses, seen, support, loudest, surprise, torch.cat(odds))


def weighed_together(parts: Sequence[Weighed]) -> Weighed:
    """All poses of the parts, in order."""
    return Weighed(
        joined([part.poses for part in parts]),
        Evidence(*(torch.cat(values) for values in zip(*(part.evidence for part in parts), strict=True))),
        *(torch.cat(values) for values in zip(*(part[2:] for part in parts), strict=True)),
    )
