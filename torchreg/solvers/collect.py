"""The best pose of every pair as a ``RegistrationResult``: coverage, origins, and whether it tells from chance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.neighborhoods.coverage import coverage
from torchreg.solvers.found import PairPoses
from torchreg.solvers.verdict import log10_false_alarms, refusal
from torchreg.types import Clouds, Correspondences, Failure, HypothesisCounts, RegistrationResult
from torchreg.types.packing import spans


class Judged(NamedTuple):
    """What the verdict on a pair needs to know.

    Attributes:
        inlier_threshold: meters.
        sample_size: correspondences that fit a hypothesis by construction.
        hypotheses: how many were tried; the verdict takes no more than there are samples.
    """

    inlier_threshold: float
    sample_size: int
    hypotheses: float


class _Outcome(NamedTuple):
    """One pair's share of the result."""

    T: Tensor
    inliers: Tensor
    fitness: Tensor
    inlier_rmse: Tensor
    failure: Failure | None


def collect(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    poses: Sequence[PairPoses],
    judged: Sequence[Judged],
) -> RegistrationResult:
    """The result of the first pose of every pair.

    Args:
        source: B clouds.
        target: B clouds.
        matches: correspondences between them, global rows.
        poses: one per pair, best first.
        judged: one per pair.
    """
    outcomes = [_outcome(source, target, matches, b, poses[b], judged[b]) for b in range(len(matches))]
    device = source.device
    none = torch.zeros(0, dtype=torch.float64, device=device)
    counts = [
        torch.tensor([getattr(pair, name) for pair in poses], dtype=torch.int64, device=device)
        for name in HypothesisCounts._fields
    ]
    return RegistrationResult(
        T_target_source=torch.cat([none.reshape(0, 4, 4), *(outcome.T[None] for outcome in outcomes)]),
        inliers=torch.cat([none.bool(), *(outcome.inliers for outcome in outcomes)]),
        fitness=torch.cat([none, *(outcome.fitness[None] for outcome in outcomes)]),
        inlier_rmse=torch.cat([none, *(outcome.inlier_rmse[None] for outcome in outcomes)]),
        success=torch.tensor([outcome.failure is None for outcome in outcomes], dtype=torch.bool, device=device),
        failure=tuple(outcome.failure for outcome in outcomes),
        hypotheses=HypothesisCounts(*counts),
        source=source,
        target=target,
        correspondences=matches,
    )


def _outcome(
    source: Clouds, target: Clouds, matches: Correspondences, b: int, poses: PairPoses, judged: Judged
) -> _Outcome:
    begin, end = spans(matches.offsets)[b]
    if len(poses.support) == 0:
        zero = torch.zeros((), dtype=torch.float64, device=source.device)
        identity = torch.eye(4, dtype=torch.float64, device=source.device)
        return _Outcome(identity, zero.bool().expand(end - begin), zero, zero, poses.failure)
    R, t = poses.rotation[0], poses.translation[0]
    near = coverage(source.select(b).points, target.select(b).points, R, t, judged.inlier_threshold)
    alarms = log10_false_alarms(
        apply_rotation(R, source.points[matches.source[begin:end]].double()) + t,
        target.points[matches.target[begin:end]].double(),
        judged.inlier_threshold,
        sample_size=judged.sample_size,
        scored=judged.hypotheses,
    )
    return _Outcome(
        rigid(R, t + target.origin[b] - apply_rotation(R, source.origin[b])),
        poses.inliers[0],
        near.fitness,
        near.inlier_rmse,
        refusal(int(poses.support[0]), end - begin, alarms),
    )
