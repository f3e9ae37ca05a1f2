"""The verdict on every pair of a batch: poses of all proposals in, one transform with its probability out."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from torchreg.geometry.numerics.threads import shared_out
from torchreg.types import Clouds, Proposal, RegistrationResult
from torchreg.verification.care import Care, Lengths
from torchreg.verification.choose import choose
from torchreg.verification.collect import Proposed, Verdict, collect
from torchreg.verification.groups import groups_of, work_of_pairs
from torchreg.verification.prepare import matched_points, poses_of, ready, scales_of
from torchreg.verification.verdicts import no_pose, verdicts


def verify(
    source: Clouds,
    target: Clouds,
    proposed: Sequence[Proposed],
    lengths: Sequence[Lengths],
    care: Care,
) -> RegistrationResult:
    """Choose among the candidate poses of every pair and judge the choice.

    Args:
        source: B clouds with normals.
        target: B clouds with normals.
        proposed: at least one.
        lengths: one per pair.
        care: how closely to look.

    Returns:
        RegistrationResult with probability and all that follows it; ``correspondences`` and ``hypotheses`` are those
        of the proposal whose matches speak loudest for the pose. No gradients.
    """
    source, target = source.detach(), target.detach()
    names, sources, targets = [part.origin for part in proposed], source.unpack(), target.unpack()
    matched = [matched_points(source, target, part.matches) for part in proposed]

    def judge(members: Sequence[int]) -> list[Verdict]:
        pairs = [
            ready(
                sources[b],
                targets[b],
                [part[b] for part in matched],
                [part.poses[b] for part in proposed],
                lengths[b],
                care.poses,
            )
            for b in members
        ]
        choice = choose(scales_of(pairs, care.sample), poses_of(pairs), care.refined, care.iterations)
        return verdicts(pairs, choice, names, care.accepted)

    workers = torch.get_num_threads() if source.device.type == "cpu" else 1
    groups = groups_of(work_of_pairs(source, target, proposed, care), workers)
    judged: dict[int, Verdict] = {}
    for members, told in zip(groups.small, shared_out(judge, groups.small, workers), strict=True):
        judged.update(zip(members, told, strict=True))
    for b in groups.large:  # alone, and every operation on all threads
        judged[b] = judge([b])[0]
    every = [judged[b] if b in judged else no_pose(proposed[0].poses[b]) for b in range(len(source))]
    return collect(source, target, proposed, every)


def proposals_of(proposed: Sequence[Proposed], b: int) -> tuple[Proposal, ...]:
    """What every proposal had for one pair."""
    return tuple(
        Proposal(
            origin=part.origin,
            matches=part.poses[b].inliers.shape[1],
            drawn=part.poses[b].drawn,
            kept=part.poses[b].kept,
            scored=part.poses[b].scored,
            poses=len(part.poses[b].support),
            support=int(part.poses[b].support[0]) if len(part.poses[b].support) > 0 else 0,
        )
        for part in proposed
    )
