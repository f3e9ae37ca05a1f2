"""From the choice among the candidates of a group of pairs to a verdict on each pair."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, inverse, rigid
from torchreg.neighborhoods.coverage import coverage
from torchreg.solvers import PairPoses
from torchreg.solvers.poses import pose_vectors
from torchreg.types import Candidate
from torchreg.verification.choose import Choice
from torchreg.verification.collect import Verdict
from torchreg.verification.model import probabilities
from torchreg.verification.poses import Poses, Run, runs_of
from torchreg.verification.prepare import Ready
from torchreg.verification.probes import FLIP, SLIDE
from torchreg.verification.reasons import refusal
from torchreg.verification.weigh import Weighed

_PROBES = {SLIDE: "slide", FLIP: "half turn"}


def verdicts(pairs: Sequence[Ready], choice: Choice, names: Sequence[str], least: float) -> list[Verdict]:
    """One of each pair.

    Args:
        pairs: G of them.
        choice: among their candidates.
        names: of the proposals.
        least: probability of a success.
    """
    found = choice.candidates
    T = _with_origins(found.poses, pairs)
    runs = runs_of(found.poses.pair)
    # pair by pair, since exponentials round differently at the end of a range
    chances = torch.cat([probabilities(found.odds[run.begin : run.end]) for run in runs])
    listed = _candidates(found, T, chances, names, [[len(part.source) for part in pair.matched] for pair in pairs])
    strength = choice.slide.strength.tolist()
    return [
        _verdict(pair, found, T, listed, run, choice.information[run.pair], strength[run.pair], least)
        for pair, run in zip(pairs, runs, strict=True)
    ]


def no_pose(poses: PairPoses) -> Verdict:
    """On a pair for which no solver found a pose."""
    device = poses.inliers.device
    eye = torch.eye(4, dtype=torch.float64, device=device)
    return Verdict(
        T=eye,
        speaker=0,
        inliers=torch.zeros(poses.inliers.shape[1], dtype=torch.bool, device=device),
        fitness=0.0,
        inlier_rmse=0.0,
        failure=poses.failure,
        probability=0.0,
        overlap=0.0,
        information=torch.zeros(6, 6, dtype=torch.float64, device=device),
        strength=0.0,
        runner_up=torch.full_like(eye, math.nan),
        margin=math.inf,
        candidates=(),
    )


def _verdict(
    pair: Ready,
    found: Weighed,
    T: Tensor,
    listed: Sequence[Candidate],
    run: Run,
    information: Tensor,
    strength: float,
    least: float,
) -> Verdict:
    rows = slice(run.begin, run.end)
    own, told = found.take(rows), listed[rows]
    R, t = own.poses.rotation[0], own.poses.translation[0]
    near = coverage(pair.source.points, pair.target.points, R, t, pair.lengths.threshold)
    speaker = int(own.spoken[0])
    matched = pair.matched[speaker]
    apart = apply_rotation(R, matched.source) + t - matched.target
    several = len(told) > 1
    return Verdict(
        T=told[0].T_target_source,
        speaker=speaker,
        inliers=apart.square().sum(dim=1) < pair.lengths.threshold**2,
        fitness=float(near.fitness),
        inlier_rmse=float(near.inlier_rmse),
        failure=refusal(
            own, [each.probability for each in told], strength, lambda: _apart(own.poses, pair.source.points), least
        ),
        probability=told[0].probability,
        overlap=told[0].overlap,
        information=information,
        strength=strength,
        runner_up=told[1].T_target_source if several else torch.full_like(T[0], math.nan),
        margin=told[0].log_odds - told[1].log_odds if several else math.inf,
        candidates=tuple(told),
    )


def _with_origins(poses: Poses, pairs: Sequence[Ready]) -> Tensor:
    """(H, 4, 4) between the frames of the files."""
    source = torch.cat([pair.source.origin for pair in pairs])[poses.pair]
    target = torch.cat([pair.target.origin for pair in pairs])[poses.pair]
    return rigid(poses.rotation, poses.translation + target - apply_rotation(poses.rotation, source))


def _apart(poses: Poses, points: Tensor) -> str:
    """How far the second pose is from the first, in words."""
    T = poses.matrices()
    R = (inverse(T[:1]) @ T[1:2])[0, :3, :3]
    cosine = float(((torch.diagonal(R).sum() - 1) / 2).clamp(-1, 1))
    vectors = pose_vectors(poses.rotation.permute(1, 2, 0), poses.translation.t(), points.double().t())
    shift = float((vectors[:, 1] - vectors[:, 0]).square().sum().sqrt())
    return f"{shift:.3g} m and {math.degrees(math.acos(cosine)):.3g} degrees away"


def _candidates(
    found: Weighed, T: Tensor, chances: Tensor, names: Sequence[str], matches: Sequence[Sequence[int]]
) -> list[Candidate]:
    """The candidates of all pairs; ``matches``: of every pair, how many each proposal has."""
    real = torch.stack([found.surprise, *found.evidence, found.odds, chances], dim=1)  # one transfer for all
    whole = torch.stack([found.poses.pair, found.poses.origin, found.spoken, found.support], dim=1)
    listed = []
    for transform, (surprise, *seen, odds, chance), (pair, origin, speaker, support) in zip(
        T.unbind(0), real.tolist(), whole.tolist(), strict=True
    ):
        overlap, closeness, normals, colors, strength, conflict = seen
        listed.append(
            Candidate(
                origin=_PROBES[origin] if origin < 0 else names[origin],
                T_target_source=transform,
                support=support,
                matches=matches[pair][speaker],
                surprise=surprise,
                overlap=overlap,
                closeness=closeness,
                normals=normals,
                colors=colors,
                strength=strength,
                conflict=conflict,
                log_odds=odds,
                probability=chance,
            )
        )
    return listed
