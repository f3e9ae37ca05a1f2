"""From matches to a ``RegistrationResult``: the best pose of every pair, its coverage, and whether it may be chance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.neighborhoods.coverage import coverage
from torchreg.solvers.batch import poses_of_pairs
from torchreg.solvers.chance import log10_false_alarms, no_consensus
from torchreg.solvers.poses import PairPoses
from torchreg.solvers.solver import Solver
from torchreg.types import Clouds, Correspondences, Failure, HypothesisCounts, RegistrationResult
from torchreg.types.packing import spans


def solve(
    source: Clouds, target: Clouds, matches: Correspondences, solver: Solver | Sequence[Solver], seed: int = 0
) -> RegistrationResult:
    """The transform that brings the most correspondences together, of every pair, by any solver.

    Args:
        source: B clouds.
        target: B clouds.
        matches: correspondences between them, global rows.
        solver: for all pairs, or one per pair.
        seed: of the call. Each pair draws from a seed made from this one and its correspondences, so its result is
            bit for bit the same in any batch, at any place in it, and with any number of threads.

    Returns:
        RegistrationResult. A pair with too few matches, or without a hypothesis, has ``success`` false and
        says why. No gradients.

    Raises:
        ValueError: the numbers of pairs differ, or a correspondence names a row outside its pair's clouds.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.solvers import solve
        >>> problem = tr.synthetic.match_problem(500, 0.8)
        >>> solve(problem.source, problem.target, problem.matches, tr.CompatibilityOptions()).success
        tensor([True])
    """
    pairs = len(matches)
    solvers = list(solver) if isinstance(solver, Sequence) else [solver] * pairs
    expect(len(solvers) == pairs, "options", f"one for all or one per pair ({pairs})", len(solvers))
    with undisturbed(source.points):
        poses = poses_of_pairs(source, target, matches, solvers, seed)
        return result_of_poses(source, target, matches, poses, solvers)


def result_of_poses(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    poses: Sequence[PairPoses],
    solvers: Sequence[Solver],
) -> RegistrationResult:
    """The result of the first pose of every pair, judged against chance; ``solvers`` gave the poses.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.solvers import poses_of_pairs, result_of_poses
        >>> problem = tr.synthetic.match_problem(500, 0.8)
        >>> solvers = [tr.CompatibilityOptions()]
        >>> poses = poses_of_pairs(problem.source, problem.target, problem.matches, solvers)
        >>> result_of_poses(problem.source, problem.target, problem.matches, poses, solvers).success
        tensor([True])
    """
    outcomes = [_outcome(source, target, matches, b, poses[b], solvers[b]) for b in range(len(matches))]
    device = source.device
    none = torch.zeros(0, dtype=torch.float64, device=device)
    return RegistrationResult(
        T_target_source=torch.cat([none.reshape(0, 4, 4), *(outcome.T[None] for outcome in outcomes)]),
        inliers=torch.cat([none.bool(), *(outcome.inliers for outcome in outcomes)]),
        fitness=torch.cat([none, *(outcome.fitness[None] for outcome in outcomes)]),
        inlier_rmse=torch.cat([none, *(outcome.inlier_rmse[None] for outcome in outcomes)]),
        success=torch.tensor([outcome.failure is None for outcome in outcomes], dtype=torch.bool, device=device),
        failure=tuple(outcome.failure for outcome in outcomes),
        hypotheses=hypothesis_counts(poses, device),
        source=source,
        target=target,
        correspondences=matches,
    )


def hypothesis_counts(poses: Sequence[PairPoses], device: torch.device) -> HypothesisCounts:
    """The counts of every pair, as tensors.

    Example:
        >>> import torch, torchreg as tr
        >>> from torchreg.solvers import hypothesis_counts, poses_of_pairs
        >>> problem = tr.synthetic.match_problem(500, 0.8)
        >>> poses = poses_of_pairs(problem.source, problem.target, problem.matches, [tr.RansacOptions()])
        >>> hypothesis_counts(poses, torch.device("cpu")).drawn.shape
        torch.Size([1])
    """
    counts = [[getattr(pair, name) for pair in poses] for name in HypothesisCounts._fields]
    return HypothesisCounts(*torch.tensor(counts, dtype=torch.int64, device=device))


class _Outcome(NamedTuple):
    """One pair's share of the result."""

    T: Tensor
    inliers: Tensor
    fitness: Tensor
    inlier_rmse: Tensor
    failure: Failure | None


def _outcome(
    source: Clouds, target: Clouds, matches: Correspondences, b: int, poses: PairPoses, solver: Solver
) -> _Outcome:
    rows = slice(*spans(matches.offsets)[b])
    count = rows.stop - rows.start
    if len(poses.support) == 0:
        zero = torch.zeros((), dtype=torch.float64, device=source.device)
        identity = torch.eye(4, dtype=torch.float64, device=source.device)
        return _Outcome(identity, zero.bool().expand(count), zero, zero, poses.failure)
    R, t = poses.rotation[0], poses.translation[0]
    near = coverage(source.select(b).points, target.select(b).points, R, t, solver.inlier_threshold)
    alarms = log10_false_alarms(
        apply_rotation(R, source.points[matches.source[rows]].double()) + t,
        target.points[matches.target[rows]].double(),
        solver.inlier_threshold,
        sample_size=solver.least_matches,
        scored=solver.tests(poses.scored),
    )
    return _Outcome(
        rigid(R, t + target.origin[b] - apply_rotation(R, source.origin[b])),
        poses.inliers[0],
        near.fitness,
        near.inlier_rmse,
        no_consensus(int(poses.support[0]), count, alarms),
    )
