"""The verdict on every pair of a batch: poses of all proposals in, one transform with its probability out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, inverse, rigid
from torchreg.hypotheses import PairPoses
from torchreg.neighbors.coverage import coverage
from torchreg.types import (
    Candidate,
    Clouds,
    Correspondences,
    Proposal,
    RegistrationResult,
)
from torchreg.types.packing import spans
from torchreg.verification.agreement import Matched
from torchreg.verification.choose import Chosen, choose
from torchreg.verification.collect import Proposed, Verdict, collect
from torchreg.verification.poses import Poses, joined
from torchreg.verification.probes import FLIP, SLIDE
from torchreg.verification.reasons import ACCEPTED, refusal
from torchreg.verification.view import view
from torchreg.verification.weigh import Scales

_PROBES = {SLIDE: "slide", FLIP: "half turn"}


class Care(NamedTuple):
    """How closely candidates are looked at.

    Attributes:
        poses: of every proposal, at most.
        sample: points of each scan that are looked at.
        refined: distinct candidates that ICP refines.
        iterations: of ICP at most.
        accepted: the least probability of a success.
    """

    poses: int
    sample: int
    refined: int
    iterations: int
    accepted: float = ACCEPTED


class Lengths(NamedTuple):
    """Meters, of one pair: an inlier's ``threshold`` and the ``spacing`` of the points."""

    threshold: float
    spacing: float


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
    verdicts = []
    for b in range(len(source)):
        found = [part.poses[b] for part in proposed]
        if any(len(pair.support) > 0 for pair in found):
            verdicts.append(_judge(source, target, proposed, b, lengths[b], care))
        else:
            verdicts.append(_nothing(source, found[0]))
    return collect(source, proposed, verdicts)


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


def _judge(
    source: Clouds, target: Clouds, proposed: Sequence[Proposed], b: int, lengths: Lengths, care: Care
) -> Verdict:
    one, center_one = _centered(source.select(b))
    other, center_other = _centered(target.select(b))
    matched = [_matched(source, target, part.matches, b) for part in proposed]
    matched = [Matched(pair.source - center_one, pair.target - center_other) for pair in matched]
    views = [view(cloud, lengths.spacing, care.sample) for cloud in (one, other)]
    scales = Scales(views[0], views[1], matched, lengths.threshold)
    parts = [
        Poses(
            pair.rotation,
            pair.translation + apply_rotation(pair.rotation, center_one.expand_as(pair.translation)) - center_other,
            torch.full_like(pair.support, number),
        ).take(slice(care.poses))
        for number, pair in enumerate(part.poses[b] for part in proposed)
    ]
    chosen = choose(scales, joined(parts), care.refined, care.iterations)
    best = chosen.candidates
    R, t = best.poses.rotation[0], best.poses.translation[0]
    near = coverage(one.points, other.points, R, t, lengths.threshold)
    speaker = int(best.spoken[0])
    apart = apply_rotation(R, matched[speaker].source) + t - matched[speaker].target
    T = _with_origins(best.poses, one, other)
    names = tuple(part.origin for part in proposed)
    return Verdict(
        T=T[0],
        speaker=speaker,
        inliers=apart.square().sum(dim=1) < lengths.threshold**2,
        fitness=float(near.fitness),
        inlier_rmse=float(near.inlier_rmse),
        reason=refusal(chosen, _apart(best.poses, scales.source.points), care.accepted),
        probability=float(chosen.probability[0]),
        overlap=float(best.evidence.overlap[0]),
        information=chosen.information,
        strength=chosen.slide.strength,
        runner_up=T[1] if len(T) > 1 else torch.full_like(T[0], math.nan),
        margin=float(best.odds[0] - best.odds[1]) if len(T) > 1 else math.inf,
        candidates=_candidates(chosen, T, names, [len(part.source) for part in matched]),
    )


def _nothing(source: Clouds, poses: PairPoses) -> Verdict:
    """A pair for which no solver found a pose."""
    eye = torch.eye(4, dtype=torch.float64, device=source.device)
    return Verdict(
        T=eye,
        speaker=0,
        inliers=torch.zeros(poses.inliers.shape[1], dtype=torch.bool, device=source.device),
        fitness=0.0,
        inlier_rmse=0.0,
        reason=poses.reason,
        probability=0.0,
        overlap=0.0,
        information=torch.zeros(6, 6, dtype=torch.float64, device=source.device),
        strength=0.0,
        runner_up=torch.full_like(eye, math.nan),
        margin=math.inf,
        candidates=(),
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


def _matched(source: Clouds, target: Clouds, matches: Correspondences, b: int) -> Matched:
    begin, end = spans(matches.offsets)[b]
    p, q = source.points[matches.source[begin:end]], target.points[matches.target[begin:end]]
    return Matched(p.double(), q.double())


def _with_origins(poses: Poses, source: Clouds, target: Clouds) -> Tensor:
    """(H, 4, 4) between the frames of the files."""
    moved = apply_rotation(poses.rotation, source.origin.expand(len(poses.origin), 3))
    return rigid(poses.rotation, poses.translation + target.origin - moved)


def _apart(poses: Poses, points: Tensor) -> str:
    """How far the second pose is from the first, in words."""
    if len(poses.origin) < 2:
        return ""
    T = poses.matrices()
    R = (inverse(T[:1]) @ T[1:2])[0, :3, :3]
    cosine = float(((torch.diagonal(R).sum() - 1) / 2).clamp(-1, 1))
    vectors = poses.vectors(points)
    shift = float((vectors[:, 1] - vectors[:, 0]).square().sum().sqrt())
    return f"{shift:.3g} m and {math.degrees(math.acos(cosine)):.3g} degrees away"


def _candidates(chosen: Chosen, T: Tensor, names: Sequence[str], matches: Sequence[int]) -> tuple[Candidate, ...]:
    found, seen = chosen.candidates, chosen.candidates.evidence
    listed = []
    for h in range(len(T)):
        origin, speaker = int(found.poses.origin[h]), int(found.spoken[h])
        listed.append(
            Candidate(
                origin=_PROBES[origin] if origin < 0 else names[origin],
                T_target_source=T[h],
                support=int(found.support[h]),
                matches=matches[speaker],
                surprise=float(found.surprise[h]),
                overlap=float(seen.overlap[h]),
                closeness=float(seen.closeness[h]),
                normals=float(seen.normals[h]),
                colors=float(seen.colors[h]),
                strength=float(seen.strength[h]),
                conflict=float(seen.conflict[h]),
                log_odds=float(found.odds[h]),
                probability=float(chosen.probability[h]),
            )
        )
    return tuple(listed)
