"""The pairs of a batch as the verification takes them: their poses and lengths, groups of pairs, and each prepared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.partition import partition
from torchreg.geometry.se3 import apply_rotation
from torchreg.solvers import PairPoses
from torchreg.types import Clouds, Correspondences, Proposal
from torchreg.types.packing import offsets_of, spans
from torchreg.verification.agreement import MatchCells, MatchEndpoints, match_cells
from torchreg.verification.candidates import Poses, joined
from torchreg.verification.reasons import ACCEPTED
from torchreg.verification.scans import Scans, prepared_scans

GIVEN = "given"
"""The origin of poses that the caller gave: one per pair, which gets a verdict of its own (``GivenVerdict``)."""

_ELEMENTS = 1 << 20
"""Work of a group at most: 30 to 60 pairs of 1,000 points. More gain nothing, and results do not depend on it."""


class WorkPerPair(NamedTuple):
    """Work spent per pair."""

    poses: int  # of every proposal, at most
    sample: int  # points of each scan that poses are weighed on
    refined: int  # distinct candidates that ICP refines
    iterations: int  # of ICP at most
    accepted: float = ACCEPTED  # the least probability of a success


WORK = {
    "fast": WorkPerPair(poses=6, sample=600, refined=1, iterations=5, accepted=0.85),
    "balanced": WorkPerPair(poses=10, sample=1000, refined=3, iterations=10),
    "thorough": WorkPerPair(poses=16, sample=1500, refined=8, iterations=20),
}
"""Work by effort. Points that lie farther apart are weaker evidence, so "fast" needs a higher probability."""


WORK_AGAIN = {
    "balanced": WorkPerPair(poses=8, sample=2000, refined=12, iterations=12),
    "thorough": WorkPerPair(poses=16, sample=1500, refined=20, iterations=20),
}
"""Work by effort at a second look, which has many more poses to choose from."""


class PairLengths(NamedTuple):
    """Meters, of one pair: an inlier's ``threshold`` and the ``spacing`` of the points."""

    threshold: float
    spacing: float


class OverlapFeatures(NamedTuple):
    """Rows of unit length that describe the points of one pair: of geometry (P, D) and of color, ``None`` without."""

    source: tuple[Tensor | None, Tensor | None] = (None, None)
    target: tuple[Tensor | None, Tensor | None] = (None, None)


class ProposedPoses(NamedTuple):
    """The poses that one set of features and one solver proposed for all pairs."""

    origin: str  # features and solver in words
    matches: Correspondences  # of B pairs
    poses: Sequence[PairPoses]  # one per pair
    coarser: float = 1.0  # how many times as far apart the points were that were matched, as ``MatchEndpoints``

    def of_pair(self, b: int, source: Clouds, target: Clouds) -> ProposedPoses:
        """Those of pair ``b`` of the batches of clouds alone, its matches as rows of its own two clouds."""
        matches = self.matches
        begin, end = matches.offsets[b : b + 2].tolist()
        own = Correspondences(
            source=matches.source[begin:end] - int(source.offsets[b]),
            target=matches.target[begin:end] - int(target.offsets[b]),
            offsets=offsets_of([end - begin]),
            score=matches.score[begin:end],
        )
        return self._replace(matches=own, poses=[self.poses[b]])


class CenteredPair(NamedTuple):
    """One pair, the points of each cloud about the middle of its bounding box."""

    source: Clouds  # one cloud, whose origin includes that middle
    target: Clouds  # as source
    matches: Sequence[MatchEndpoints]  # of every proposal, between those frames
    poses: Poses  # of all proposals, between those frames
    lengths: PairLengths
    features: OverlapFeatures


class PreparedPairs(NamedTuple):
    """The scans and matches of G pairs, on which poses are weighed."""

    source: Scans
    target: Scans
    matches: Sequence[Sequence[MatchCells]]  # of every pair, those of every proposal
    threshold: Tensor  # (G,) float64, meters, of an inlier


class Groups(NamedTuple):
    """The pairs that have poses."""

    small: list[list[int]]  # numbers of pairs that take every step together
    large: list[int]  # pairs that are judged alone


def proposals_of(proposed: Sequence[ProposedPoses], b: int) -> tuple[Proposal, ...]:
    """The counts of every proposal for one pair."""
    return tuple(
        Proposal(
            origin=part.origin,
            matches=poses.inliers.shape[1],
            drawn=poses.drawn,
            kept=poses.kept,
            scored=poses.scored,
            poses=len(poses.support),
            support=int(poses.support[0]) if len(poses.support) > 0 else 0,
        )
        for part, poses in ((part, part.poses[b]) for part in proposed)
    )


def groups_of(work: Sequence[int], workers: int) -> Groups:
    """Cut pairs with this much work into groups, as many as there are workers where there is enough for them."""
    small = [b for b, amount in enumerate(work) if 0 < amount <= _ELEMENTS]
    costs = [work[b] for b in small]
    groups = partition(costs, min(_ELEMENTS, -(-sum(costs) // max(1, workers))))
    return Groups([small[group] for group in groups], [b for b, amount in enumerate(work) if amount > _ELEMENTS])


def work_of_pairs(source: Clouds, target: Clouds, proposed: Sequence[ProposedPoses], work: WorkPerPair) -> list[int]:
    """Of every pair, its points and the points that its poses move; 0 without poses."""
    amounts = []
    for b, sizes in enumerate(zip(source.lengths, target.lengths, strict=True)):
        poses = sum(min(work.poses, len(part.poses[b].support)) for part in proposed)
        sampled = sum(min(size, work.sample) for size in sizes)
        amounts.append(sum(sizes) + poses * sampled if poses > 0 else 0)
    return amounts


def match_endpoints(source: Clouds, target: Clouds, proposed: ProposedPoses) -> list[MatchEndpoints]:
    """The matched points of every pair of a batch."""
    matches = proposed.matches
    p, q = source.points[matches.source].double(), target.points[matches.target].double()
    return [MatchEndpoints(p[begin:end], q[begin:end], proposed.coarser) for begin, end in spans(matches.offsets)]


def centered_pair(
    source: Clouds,
    target: Clouds,
    matches: Sequence[MatchEndpoints],
    poses: Sequence[PairPoses],
    lengths: PairLengths,
    features: OverlapFeatures,
    most: int,
) -> CenteredPair:
    """One pair, clouds of a batch of one each, with the matches and at most so many poses of every proposal."""
    one, source_center = _centered(source)
    other, target_center = _centered(target)
    parts = []
    for number, part in enumerate(poses):
        moved = apply_rotation(part.rotation, source_center.expand_as(part.translation))
        origin = torch.full_like(part.support, number)
        centered = Poses(part.rotation, part.translation + moved - target_center, origin, torch.zeros_like(origin))
        parts.append(centered.take(slice(most)))
    endpoints = [
        part._replace(source=part.source - source_center, target=part.target - target_center) for part in matches
    ]
    return CenteredPair(one, other, endpoints, joined(parts), lengths, features)


def prepared_pairs(pairs: Sequence[CenteredPair], sample: int) -> PreparedPairs:
    """Prepare G pairs, ``sample`` points of each scan."""
    spacings, thresholds = [pair.lengths.spacing for pair in pairs], [pair.lengths.threshold for pair in pairs]
    threshold = torch.tensor(thresholds, dtype=torch.float64, device=pairs[0].source.device)
    sources, targets = [pair.source for pair in pairs], [pair.target for pair in pairs]
    of_sources, of_targets = [pair.features.source for pair in pairs], [pair.features.target for pair in pairs]
    return PreparedPairs(
        source=prepared_scans(sources, spacings, threshold, sample, of_sources),
        target=prepared_scans(targets, spacings, threshold, sample, of_targets),
        matches=[[match_cells(part, pair.lengths.threshold) for part in pair.matches] for pair in pairs],
        threshold=threshold,
    )


def initial_poses(pairs: Sequence[CenteredPair]) -> Poses:
    """The proposed poses of G pairs, pair by pair."""
    return joined([pair.poses._replace(pair=torch.full_like(pair.poses.pair, g)) for g, pair in enumerate(pairs)])


def middle(cloud: Clouds) -> Tensor:
    """The middle (3,) float64 of the bounding box of one cloud, meters; zero without points."""
    if len(cloud.points) == 0:
        return torch.zeros(3, dtype=torch.float64, device=cloud.device)
    wide = cloud.points.double()
    return (wide.amin(dim=0) + wide.amax(dim=0)) / 2


def _centered(cloud: Clouds) -> tuple[Clouds, Tensor]:
    """One cloud in float32 about its middle (3,) float64, which becomes part of the origin: so no digits are lost."""
    wide, center = cloud.points.double(), middle(cloud)
    moved = Clouds(
        points=(wide - center).float(),
        colors=None if cloud.colors is None else cloud.colors.float(),
        normals=None if cloud.normals is None else cloud.normals.float(),
        origin=cloud.origin + center,
        viewpoint=None if cloud.viewpoint is None else (cloud.viewpoint.double() - center).float(),
        viewpoint_assumed=cloud.viewpoint_assumed,
    )
    return moved, center
