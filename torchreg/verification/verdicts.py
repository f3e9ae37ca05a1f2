"""From the choice among the candidates of pairs to a verdict on each, and from all verdicts to the result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.neighborhoods.coverage import coverage
from torchreg.solvers import PairPoses, hypothesis_counts
from torchreg.types import Candidate, Clouds, Correspondences, Failure, RegistrationResult
from torchreg.types.packing import offsets_of
from torchreg.verification.agreement import MatchEndpoints
from torchreg.verification.candidates import SLIDE, TURN, Candidates, Choice, Poses, joined, runs_of
from torchreg.verification.given import GivenVerdict, given_verdict
from torchreg.verification.impostors import impostor
from torchreg.verification.model import probabilities
from torchreg.verification.pairs import CenteredPair, ProposedPoses
from torchreg.verification.reasons import failure_of
from torchreg.verification.similarity import RigidFit

_PROBES = {SLIDE: "slide", TURN: "turn"}


class Verdict(NamedTuple):
    """One pair's share of the result, its fields as there; ``proposal`` is the one whose matches support it most."""

    T: Tensor
    proposal: int
    inliers: Tensor
    fitness: float
    inlier_rmse: float
    failure: Failure | None
    probability: float
    overlap: float
    information: Tensor
    strength: float
    runner_up: Tensor
    margin: float
    candidates: tuple[Candidate, ...]
    given: GivenVerdict | None = None  # on the given pose, where there is one


class JudgedPair(NamedTuple):
    """The verdict on one pair, and the proposal whose matches support the pose most."""

    verdict: Verdict
    matches: Correspondences  # of that proposal, as rows of the pair's own two clouds
    poses: PairPoses  # of that proposal


def verdicts(pairs: Sequence[CenteredPair], choice: Choice, names: Sequence[str], least: float) -> list[Verdict]:
    """The verdict on each of G pairs; ``names`` are those of the proposals, ``least`` the probability of a success."""
    weighed = choice.candidates
    T = _with_origins(weighed.poses, pairs)
    runs = runs_of(weighed.poses.pair)
    # pair by pair, since exponentials round differently at the end of a range
    chances = torch.cat([probabilities(weighed.odds[run.begin : run.end]) for run in runs])
    matches = [[len(part.source) for part in pair.matches] for pair in pairs]
    described = _described(weighed, T, chances, names, matches)
    strength = choice.motion.strength.tolist()
    judged = [
        _verdict(
            pair,
            weighed.take(slice(begin, end)),
            tuple(described[begin:end]),
            choice.information[number],
            strength[number],
            least,
        )
        for pair, (number, begin, end) in zip(pairs, runs, strict=True)
    ]
    if choice.given is None:
        return judged
    given = choice.given
    both = joined([given.as_given, given.refined])
    exact = _described(both, _with_origins(both.poses, pairs), torch.zeros_like(both.odds), names, matches)
    return [
        verdict._replace(
            given=given_verdict(
                pair,
                weighed.take(slice(begin, end)),
                verdict.candidates,
                verdict.failure,
                both.take(slice(number, None, len(pairs))),
                exact[number :: len(pairs)],
                given.within_reach[number],
                least,
            )
        )
        for pair, verdict, (number, begin, end) in zip(pairs, judged, runs, strict=True)
    ]


def no_pose(poses: PairPoses) -> Verdict:
    """The verdict on a pair for which no solver has a pose."""
    device = poses.inliers.device
    eye = torch.eye(4, dtype=torch.float64, device=device)
    return Verdict(
        T=eye,
        proposal=0,
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


def judged_pair(verdict: Verdict, proposed: ProposedPoses, source: Clouds, target: Clouds, b: int) -> JudgedPair:
    """The verdict on pair ``b`` of a batch with what it stands on."""
    own = proposed.of_pair(b, source, target)
    return JudgedPair(verdict, own.matches, own.poses[0])


def collect(source: Clouds, target: Clouds, judged: Sequence[JudgedPair]) -> RegistrationResult:
    """The result of B pairs, at least one, from the verdicts on them.

    ``correspondences`` and ``hypotheses`` are those of the proposal whose matches support the pose most.
    """
    source, target, device = source.detach(), target.detach(), source.device
    verdicts = [pair.verdict for pair in judged]

    def numbers(name: str) -> Tensor:
        return torch.tensor([getattr(verdict, name) for verdict in verdicts], dtype=torch.float64, device=device)

    def stacked(name: str) -> Tensor:
        return torch.stack([getattr(verdict, name) for verdict in verdicts])

    def matched(name: str, firsts: Tensor) -> Tensor:
        parts = zip((getattr(pair.matches, name) for pair in judged), firsts.tolist(), strict=False)
        return torch.cat([rows + first for rows, first in parts])

    return RegistrationResult(
        T_target_source=stacked("T"),
        inliers=torch.cat([verdict.inliers for verdict in verdicts]),
        fitness=numbers("fitness"),
        inlier_rmse=numbers("inlier_rmse"),
        success=torch.tensor([verdict.failure is None for verdict in verdicts], dtype=torch.bool, device=device),
        failure=tuple(verdict.failure for verdict in verdicts),
        hypotheses=hypothesis_counts([pair.poses for pair in judged], device),
        source=source,
        target=target,
        correspondences=Correspondences(
            source=matched("source", source.offsets),
            target=matched("target", target.offsets),
            offsets=offsets_of(len(pair.matches.source) for pair in judged),
            score=torch.cat([pair.matches.score for pair in judged]),
        ),
        probability=numbers("probability"),
        overlap=numbers("overlap"),
        information=stacked("information"),
        strength=numbers("strength"),
        runner_up=stacked("runner_up"),
        margin=numbers("margin"),
        candidates=tuple(verdict.candidates for verdict in verdicts),
    )


def _verdict(
    pair: CenteredPair,
    weighed: Candidates,
    described: tuple[Candidate, ...],
    information: Tensor,
    strength: float,
    least: float,
) -> Verdict:
    """On one pair, from its candidates, best first, and their descriptions."""
    R, t = weighed.poses.rotation[0], weighed.poses.translation[0]
    near = coverage(pair.source.points, pair.target.points, R, t, pair.lengths.threshold)
    proposal = int(weighed.proposal[0])
    inliers = _inliers(pair.matches[proposal], R, t, pair.lengths.threshold)
    impossible = None
    for number in dict.fromkeys((0, proposal)):  # the first has all matches of a set of features
        matches = pair.matches[number]
        within = pair.lengths.threshold * matches.coarser
        facing = float(weighed.evidence.normals[0])  # NaN without normals
        rigid_fit = RigidFit(_inliers(matches, R, t, within), float(weighed.surprise[0]), facing)
        impossible = impossible or impostor(matches, within, rigid_fit)
    if impossible is not None:  # then no rigid pose is right
        described = tuple(each._replace(probability=0.0) for each in described)
    best, several = described[0], len(described) > 1
    return Verdict(
        T=best.T_target_source,
        proposal=proposal,
        inliers=inliers,
        fitness=float(near.fitness),
        inlier_rmse=float(near.inlier_rmse),
        failure=impossible
        or failure_of(weighed, [each.probability for each in described], strength, pair.source.points, least),
        probability=best.probability,
        overlap=best.overlap,
        information=information,
        strength=strength,
        runner_up=described[1].T_target_source if several else torch.full_like(best.T_target_source, math.nan),
        margin=best.log_odds - described[1].log_odds if several else math.inf,
        candidates=described,
    )


def _inliers(matches: MatchEndpoints, R: Tensor, t: Tensor, threshold: float) -> Tensor:
    """(M,) bool: which matches a pose brings within the threshold, meters."""
    residual = apply_rotation(R, matches.source) + t - matches.target
    return residual.square().sum(dim=1) < threshold**2


def _with_origins(poses: Poses, pairs: Sequence[CenteredPair]) -> Tensor:
    """(H, 4, 4) between the frames of the files."""
    source = torch.cat([pair.source.origin for pair in pairs])[poses.pair]
    target = torch.cat([pair.target.origin for pair in pairs])[poses.pair]
    return rigid(poses.rotation, poses.translation + target - apply_rotation(poses.rotation, source))


def _described(
    weighed: Candidates, T: Tensor, chances: Tensor, names: Sequence[str], matches: Sequence[Sequence[int]]
) -> list[Candidate]:
    """The candidates of all pairs as the result lists them; ``matches``: of every pair, how many each proposal has."""
    real = torch.stack([weighed.surprise, *weighed.evidence, weighed.odds, chances], dim=1)  # one transfer for all
    whole = torch.stack([weighed.poses.pair, weighed.poses.origin, weighed.proposal, weighed.support], dim=1)
    return [
        Candidate(
            _PROBES[origin] if origin < 0 else names[origin], transform, support, matches[pair][proposal], *figures
        )
        for transform, figures, (pair, origin, proposal, support) in zip(
            T.unbind(0), real.tolist(), whole.tolist(), strict=True
        )
    ]
