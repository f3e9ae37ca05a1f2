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
from torchreg.types.packing import offsets_of, spans
from torchreg.verification.candidates import HALF_TURN, SLIDE, Candidates, Choice, Poses, runs_of
from torchreg.verification.impostors import impostor
from torchreg.verification.model import probabilities
from torchreg.verification.pairs import CenteredPair, ProposedPoses
from torchreg.verification.reasons import failure_of
from torchreg.verification.similarity import RigidFit

_PROBES = {SLIDE: "slide", HALF_TURN: "half turn"}


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
    return [
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


def collect(
    source: Clouds, target: Clouds, proposed: Sequence[ProposedPoses], verdicts: Sequence[Verdict]
) -> RegistrationResult:
    """The result of B pairs from their verdicts, each with the matches of the proposal that supports it most."""
    device = source.device

    def numbers(name: str) -> Tensor:
        return torch.tensor([getattr(verdict, name) for verdict in verdicts], dtype=torch.float64, device=device)

    def stacked(name: str, *size: int) -> Tensor:
        empty = torch.zeros(0, *size, dtype=torch.float64, device=device)
        return torch.cat([empty, *(getattr(verdict, name)[None] for verdict in verdicts)])

    chosen = [proposed[verdict.proposal] for verdict in verdicts]
    rows = [slice(*spans(part.matches.offsets)[b]) for b, part in enumerate(chosen)]
    first = proposed[0].matches

    def matched(name: str) -> Tensor:
        parts = [getattr(part.matches, name)[of_pair] for part, of_pair in zip(chosen, rows, strict=True)]
        return torch.cat([getattr(first, name)[:0], *parts])

    return RegistrationResult(
        T_target_source=stacked("T", 4, 4),
        inliers=torch.cat([first.source[:0].bool(), *(verdict.inliers for verdict in verdicts)]),
        fitness=numbers("fitness"),
        inlier_rmse=numbers("inlier_rmse"),
        success=torch.tensor([verdict.failure is None for verdict in verdicts], dtype=torch.bool, device=device),
        failure=tuple(verdict.failure for verdict in verdicts),
        hypotheses=hypothesis_counts([part.poses[b] for b, part in enumerate(chosen)], device),
        source=source,
        target=target,
        correspondences=Correspondences(
            source=matched("source"),
            target=matched("target"),
            offsets=offsets_of(part.stop - part.start for part in rows),
            score=matched("score"),
        ),
        probability=numbers("probability"),
        overlap=numbers("overlap"),
        information=stacked("information", 6, 6),
        strength=numbers("strength"),
        runner_up=stacked("runner_up", 4, 4),
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
    matches = pair.matches[proposal]
    residual = apply_rotation(R, matches.source) + t - matches.target
    inliers = residual.square().sum(dim=1) < pair.lengths.threshold**2
    impossible = impostor(matches, pair.lengths.threshold, RigidFit(inliers, float(weighed.surprise[0])))
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
