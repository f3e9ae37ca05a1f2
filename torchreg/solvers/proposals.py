"""All hypotheses of a pair with their proposed counts, and the poses that come of them, for many pairs together.

One dominating mode must not push out the others: the best of a wrong symmetry may be the best but one by far less
than the hypotheses around the best are. So beside the ``LEADERS`` with the highest counts, hypotheses are taken from
the best down that lie apart from one another. All of them are scored exactly and refitted to their inliers, and
again those that lie apart are kept.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.solvers.distinct import pose_vectors_of_pairs, spread_out_pairs
from torchreg.solvers.points import PairPoints, ranks
from torchreg.solvers.refine import Quality, Scored, best_first, optimize, score

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
_STORED = 1 << 17


class Proposals:
    """Hypotheses as they come, in the order of their proposed counts, ties to the earlier one."""

    def __init__(self, device: torch.device, dtype: torch.dtype) -> None:
        self.total = 0
        self.stored = 0
        self._rotation = [torch.empty(3, 3, 0, device=device, dtype=dtype)]
        self._translation = [torch.empty(3, 0, device=device, dtype=dtype)]
        self._key = [torch.empty(0, dtype=torch.int64, device=device)]

    @property
    def dtype(self) -> torch.dtype:
        """Of the hypotheses."""
        return self._rotation[0].dtype

    def add(self, rotation: Tensor, translation: Tensor, proposed: Tensor) -> None:
        """Enter hypotheses (3, 3, H), (3, H) with proposed counts (H,)."""
        number = torch.arange(self.total, self.total + len(proposed), device=proposed.device)
        self._rotation.append(rotation)
        self._translation.append(translation)
        self._key.append(proposed.long() * (1 << 40) - number)  # distinct, so that their order is one only
        self.total += len(proposed)
        self.stored += len(proposed)
        if self.stored > 2 * _STORED:
            self._keep(_STORED)

    def best(self, count: int) -> tuple[Tensor, Tensor]:
        """Rotations (3, 3, F) and translations (3, F), best first."""
        rotation, translation, key = self._all()
        top = key.topk(min(count, len(key))).indices
        return rotation[..., top], translation[:, top]

    def _all(self) -> tuple[Tensor, Tensor, Tensor]:
        return torch.cat(self._rotation, dim=-1), torch.cat(self._translation, dim=-1), torch.cat(self._key)

    def _keep(self, count: int) -> None:
        rotation, translation, key = self._all()
        top = key.topk(min(count, len(key))).indices
        self._rotation, self._translation, self._key = [rotation[..., top]], [translation[:, top]], [key[top]]
        self.stored = len(top)


def distinct_poses(proposals: Sequence[Proposals], points: PairPoints, rounds: int, quality: Quality) -> Scored:
    """The distinct poses of all proposals of every pair, best first, each refitted at most ``rounds`` times.

    Args:
        proposals: of each pair at least one hypothesis, all of one dtype.
        points: of the same pairs.
        rounds: of local optimization.
        quality: what they are compared by.
    """
    sides = [each.best(each.stored) for each in proposals]
    rotation, translation = (torch.cat(side, dim=-1) for side in zip(*sides, strict=True))
    lengths = torch.tensor([each.stored for each in proposals], device=rotation.device)
    pair = torch.arange(len(lengths), device=rotation.device).repeat_interleave(lengths)
    radii = [APART * threshold for threshold in points.thresholds]

    def exact(places: Tensor) -> Scored:
        turned = orthonormal(rotation[..., places].double())
        return score(turned, translation[:, places].double(), pair[places], points, quality)

    def distinct(poses: Scored) -> Scored:
        poses = poses.take(best_first(poses))
        vectors = pose_vectors_of_pairs(poses.rotation, poses.translation, poses.pair, points)
        return poses.take(spread_out_pairs(vectors, poses.pair, radii, POSES))

    leaders = exact((ranks(pair) < LEADERS).nonzero()[:, 0])
    leaders = leaders.take(best_first(leaders))
    leaders = leaders.take((ranks(leaders.pair) < OPTIMIZED).nonzero()[:, 0])
    vectors = pose_vectors_of_pairs(rotation, translation, pair, points)
    others = exact(spread_out_pairs(vectors, pair, radii, _SPREAD))
    poses = distinct(optimize(leaders.join(others), points, min(rounds, _FIRST_ROUNDS), quality))
    return distinct(optimize(poses, points, rounds - _FIRST_ROUNDS, quality))


def orthonormal(rotation: Tensor) -> Tensor:
    """The nearest rotations to (3, 3, F) matrices that are rotations up to the rounding of a proposal."""
    u, _, vh = torch.linalg.svd(rotation.permute(2, 0, 1))
    nearest: Tensor = u @ vh
    return nearest.permute(1, 2, 0)


def proposal_dtype(source: Tensor, target: Tensor, threshold: float) -> torch.dtype:
    """float32 where its rounding of |R p + t - q|^2 stays far below the squared threshold, else float64."""
    reach = float(torch.maximum(source.abs().amax(), target.abs().amax()))
    rounding = 12 * (3 * reach * reach) * torch.finfo(torch.float32).eps
    return torch.float32 if rounding < 0.1 * threshold * threshold else torch.float64
