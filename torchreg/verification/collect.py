"""The verdicts on all pairs of a batch as one ``RegistrationResult``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.solvers import PairPoses
from torchreg.types import Candidate, Clouds, Correspondences, Failure, HypothesisCounts, RegistrationResult
from torchreg.types.packing import offsets_of, spans


class Proposed(NamedTuple):
    """What one set of features and one solver proposed for all pairs.

    Attributes:
        origin: in words.
        matches: of B pairs.
        poses: one per pair.
    """

    origin: str
    matches: Correspondences
    poses: Sequence[PairPoses]


class Verdict(NamedTuple):
    """One pair's share of the result, its fields as there; ``speaker`` is the proposal whose matches stand for it."""

    T: Tensor
    speaker: int
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


def collect(
    source: Clouds, target: Clouds, proposed: Sequence[Proposed], verdicts: Sequence[Verdict]
) -> RegistrationResult:
    """The result of B pairs from their verdicts, each with the matches of the proposal that speaks for it."""
    device = source.device

    def numbers(name: str) -> Tensor:
        return torch.tensor([getattr(item, name) for item in verdicts], dtype=torch.float64, device=device)

    def stacked(name: str, *size: int) -> Tensor:
        empty = torch.zeros(0, *size, dtype=torch.float64, device=device)
        return torch.cat([empty, *(getattr(item, name)[None] for item in verdicts)])

    parts = []
    for b, item in enumerate(verdicts):
        matches = proposed[item.speaker].matches
        begin, end = spans(matches.offsets)[b]
        parts.append((matches.source[begin:end], matches.target[begin:end], matches.score[begin:end]))
    first = proposed[0].matches
    joint = Correspondences(
        source=torch.cat([first.source[:0], *(part[0] for part in parts)]),
        target=torch.cat([first.target[:0], *(part[1] for part in parts)]),
        offsets=offsets_of(len(part[0]) for part in parts),
        score=torch.cat([first.score[:0], *(part[2] for part in parts)]),
    )
    speakers = [proposed[item.speaker].poses[b] for b, item in enumerate(verdicts)]
    counts = [
        torch.tensor([getattr(pair, name) for pair in speakers], dtype=torch.int64, device=device)
        for name in HypothesisCounts._fields
    ]
    return RegistrationResult(
        T_target_source=stacked("T", 4, 4),
        inliers=torch.cat([joint.source[:0].bool(), *(item.inliers for item in verdicts)]),
        fitness=numbers("fitness"),
        inlier_rmse=numbers("inlier_rmse"),
        success=torch.tensor([item.failure is None for item in verdicts], dtype=torch.bool, device=device),
        failure=tuple(item.failure for item in verdicts),
        hypotheses=HypothesisCounts(*counts),
        source=source,
        target=target,
        correspondences=joint,
        probability=numbers("probability"),
        overlap=numbers("overlap"),
        information=stacked("information", 6, 6),
        strength=numbers("strength"),
        runner_up=stacked("runner_up", 4, 4),
        margin=numbers("margin"),
        candidates=tuple(item.candidates for item in verdicts),
    )
