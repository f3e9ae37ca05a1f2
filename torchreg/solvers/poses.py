"""Distinct poses of pairs: hypotheses scored exactly, refitted, and chosen greedily from the best down.

One dominating mode must not push out the others: many hypotheses near the best one may score higher than the best
hypothesis of another mode, which a symmetric scene may make the right one. So beside the ``LEADERS`` with the highest
counts, hypotheses that lie apart from one another are taken from the best down. All of them are scored exactly and
refitted to their inliers, and of the results again those that lie apart are kept.

Two poses differ by how far apart they put the matched source points, root mean square. With the points' mean c
and covariance S that is

    rms^2 = |dR c + dt|^2 + tr(dR S dR^T),   dR = R_1 - R_2, dt = t_1 - t_2

the squared distance of two vectors of 12 numbers, (R S^(1/2), R c + t): no point needs to be moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import lane_sums
from torchreg.geometry.se3 import apply_rotation
from torchreg.native import KERNEL_TYPES, call, native
from torchreg.solvers.local_optimization import optimize
from torchreg.solvers.points import PairPoints, first_of_each, ranks
from torchreg.solvers.scoring import Quality, Scored, orthonormal, score
from torchreg.solvers.solver import Hypotheses
from torchreg.types import Failure

POSES = 16
"""Distinct poses that a solver gives at most."""

APART = 4.0
"""Inlier thresholds, root mean square over the matched points, that distinct poses are apart at least."""

LEADERS = 64
"""Hypotheses that are scored exactly for their proposed inliers."""

OPTIMIZED = 8
"""Of those, how many are refitted to their inliers."""

_SPREAD = 32  # hypotheses that are refitted for lying apart
_FIRST_ROUNDS = 2  # of refits; after them, most have met


class PairPoses(NamedTuple):
    """The poses of one pair, best first and distinct; H = 0 beside a failure.

    A pose takes ``source.points`` to ``target.points``: x_target = R x_source + t, origins left out.

    Attributes:
        rotation: (H, 3, 3) float64.
        translation: (H, 3) float64, meters.
        inliers: (H, M) bool over the pair's correspondences.
        support: (H,) int64, number of inliers.
        error: (H,) float64, sum of squared residuals of the inliers, square meters.
        drawn: hypotheses begun.
        kept: those that passed the first test.
        scored: poses scored on all correspondences.
        failure: why there is no pose, else ``None``.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.solvers import poses_of_pairs
        >>> problem = tr.synthetic.match_problem(500, 0.8)
        >>> poses, = poses_of_pairs(problem.source, problem.target, problem.matches, [tr.CompatibilityOptions()])
        >>> poses.failure is None
        True
    """

    rotation: Tensor
    translation: Tensor
    inliers: Tensor
    support: Tensor
    error: Tensor
    drawn: int
    kept: int
    scored: int
    failure: Failure | None


def no_pose(matches: int, device: torch.device, failure: Failure | None, drawn: int = 0, kept: int = 0) -> PairPoses:
    """The poses of a pair with so many matches and no hypothesis."""
    empty = torch.zeros(0, dtype=torch.float64, device=device)
    inliers = torch.zeros(0, matches, dtype=torch.bool, device=device)
    return PairPoses(empty.reshape(0, 3, 3), empty.reshape(0, 3), inliers, empty.long(), empty, drawn, kept, 0, failure)


def poses_of(hypotheses: Sequence[Hypotheses], points: PairPoints, rounds: int, quality: Quality) -> list[PairPoses]:
    """The distinct poses of every pair, best first by ``quality``, each refitted at most ``rounds`` times.

    Every pair has at least one hypothesis; all are of one dtype.
    """
    poses = _distinct(hypotheses, points, rounds, quality)
    R = poses.rotation.permute(2, 0, 1).contiguous()  # (H, 3, 3)
    t = poses.translation.t() + points.target_center[poses.pair]
    t = t - apply_rotation(R, points.source_center[poses.pair])
    lengths = torch.bincount(poses.pair, minlength=len(hypotheses)).tolist()
    columns = [part.split(lengths) for part in (R, t, poses.inliers, poses.support, poses.error)]
    return [
        PairPoses(R, t, inliers[:, :matches].contiguous(), support, error, each.drawn, each.kept, each.total, None)
        for R, t, inliers, support, error, matches, each in zip(*columns, points.counts, hypotheses, strict=True)
    ]


def _distinct(hypotheses: Sequence[Hypotheses], points: PairPoints, rounds: int, quality: Quality) -> Scored:
    """The poses of all pairs, pair by pair, best first, about the means of the points."""
    sides = [each.best(each.stored) for each in hypotheses]
    rotation, translation = (torch.cat(side, dim=-1) for side in zip(*sides, strict=True))
    lengths = torch.tensor([each.stored for each in hypotheses], device=rotation.device)
    pair = torch.arange(len(lengths), device=rotation.device).repeat_interleave(lengths)
    radii = [APART * threshold for threshold in points.thresholds]
    moments = _moments(points.source, points.valid, points.counts)

    def exact(places: Tensor) -> Scored:
        turned = orthonormal(rotation[..., places].double())
        return score(turned, translation[:, places].double(), pair[places], points, quality)

    def distinct(poses: Scored) -> Scored:
        poses = poses.take(poses.best_first())
        vectors = pose_vectors_of_pairs(poses.rotation, poses.translation, poses.pair, moments)
        return poses.take(spread_out(vectors, poses.pair, radii, POSES))

    leaders = exact((ranks(pair) < LEADERS).nonzero()[:, 0])
    leaders = leaders.take(leaders.best_first())
    leaders = leaders.take((ranks(leaders.pair) < OPTIMIZED).nonzero()[:, 0])
    vectors = pose_vectors_of_pairs(rotation, translation, pair, moments)
    others = exact(spread_out(vectors, pair, radii, _SPREAD))
    poses = distinct(optimize(leaders.join(others), points, min(rounds, _FIRST_ROUNDS), quality))
    return distinct(optimize(poses, points, rounds - _FIRST_ROUNDS, quality))


def pose_vectors(rotation: Tensor, translation: Tensor, source: Tensor) -> Tensor:
    """(12, H) of poses (3, 3, H), (3, H): their distances are rms displacements of ``source`` (3, M), meters.

    Elementwise operations, so that the bits of a pose do not depend on the others.
    """
    mean, root = _moments(source[:, None], torch.ones_like(source[:1], dtype=torch.bool), [source.shape[1]])
    return _vectors(rotation, translation, mean.to(rotation), root.to(rotation))


def pose_vectors_of_pairs(
    rotation: Tensor, translation: Tensor, pair: Tensor, moments: tuple[Tensor, Tensor]
) -> Tensor:
    """``pose_vectors`` of poses of the pairs ``pair`` (H,), each by the means and roots (``_moments``) of its pair."""
    mean, root = moments
    return _vectors(rotation, translation, mean.to(rotation)[:, pair], root.to(rotation)[..., pair])


def spread_out(vectors: Tensor, pair: Tensor, radii: Sequence[float], count: int) -> Tensor:
    """Choose poses one by one, leaving out those nearer than a radius to a chosen one of the same pair.

    ``vectors`` (12, H) are those of a pair together, best first; ``pair`` (H,) ascends; ``radii`` of each pair are in
    meters. At most ``count`` are chosen of each pair. Returns their places (K,), ascending.
    """
    limits = torch.tensor([radius * radius for radius in radii], dtype=torch.float64).to(vectors)
    if native(vectors, pair) and vectors.dtype in KERNEL_TYPES:
        return _places_compiled(vectors, pair, limits, count)
    place = torch.arange(vectors.shape[1], device=vectors.device)
    chosen = [place[:0]]
    for _ in range(count):
        if len(place) == 0:
            break
        first = first_of_each(pair)
        chosen.append(place[first])
        difference = vectors - vectors[:, first][:, first.cumsum(dim=0) - 1]
        apart = (_square(difference) > limits[pair]).nonzero()[:, 0]
        place, pair, vectors = place[apart], pair[apart], vectors[:, apart]
    return torch.cat(chosen).sort().values


def _places_compiled(vectors: Tensor, pair: Tensor, limits: Tensor, count: int) -> Tensor:
    """As ``spread_out``, with squares of the radii (B,)."""
    places = torch.empty_like(pair, memory_format=torch.contiguous_format)
    given = (vectors.contiguous(), pair.contiguous(), limits, len(pair), count)
    return places[: call(f"spread_out_{KERNEL_TYPES[vectors.dtype]}", *given, places)]


def _square(difference: Tensor) -> Tensor:
    """Squared lengths (H,) of vectors (12, H), which it overwrites; terms are added in their order."""
    difference.mul_(difference)
    total = difference[0]
    for row in difference[1:]:
        total += row
    return total


def _vectors(rotation: Tensor, translation: Tensor, mean: Tensor, root: Tensor) -> Tensor:
    """From means (3,) or (3, H) and roots of covariances (3, 3) or (3, 3, H)."""
    columns = [*root.unbind(dim=1), mean]  # four directions
    rotated = [rotation[:, 0] * x + rotation[:, 1] * y + rotation[:, 2] * z for x, y, z in columns]  # (3, H) each
    rotated[3] = rotated[3] + translation
    return torch.cat(rotated)


def _moments(source: Tensor, valid: Tensor, counts: Sequence[int]) -> tuple[Tensor, Tensor]:
    """The means (3, B) and roots (3, 3, B) of the covariances of points (3, B, M), where valid (B, M)."""
    count = torch.tensor([max(1, number) for number in counts], dtype=source.dtype, device=source.device)
    mean = lane_sums(source) / count
    moved = torch.where(valid, source - mean[..., None], 0.0)
    products = lane_sums((moved[:, None] * moved[None]).flatten(0, 1)) / count  # (9, B)
    values, vectors = torch.linalg.eigh(products.t().reshape(-1, 3, 3))
    root = vectors * values.clamp(min=0).sqrt()[:, None]
    return mean, root.permute(1, 2, 0)
