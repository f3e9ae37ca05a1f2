"""All hypotheses of one pair with their proposed counts, and the poses that come of them.

One dominating mode must not push out the others: the best of a wrong symmetry may be the best but one by far less
than the hypotheses around the best are. So beside the ``LEADERS`` with the highest counts, hypotheses are taken from
the best down that lie apart from one another. All of them are scored exactly and refitted to their inliers, and
again those that lie apart are kept.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.hypotheses.distinct import pose_vectors, spread_out
from torchreg.hypotheses.refine import Quality, Scored, best_first, optimize, score

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

    def __init__(self, device: torch.device) -> None:
        self.total = 0
        self._rotation = [torch.empty(3, 3, 0, device=device)]
        self._translation = [torch.empty(3, 0, device=device)]
        self._key = [torch.empty(0, dtype=torch.int64, device=device)]
        self._stored = 0

    def add(self, rotation: Tensor, translation: Tensor, proposed: Tensor) -> None:
        """Enter hypotheses (3, 3, H), (3, H) with proposed counts (H,)."""
        number = torch.arange(self.total, self.total + len(proposed), device=proposed.device)
        self._rotation.append(rotation)
        self._translation.append(translation)
        self._key.append(proposed.long() * (1 << 40) - number)  # distinct, so that their order is one only
        self.total += len(proposed)
        self._stored += len(proposed)
        if self._stored > 2 * _STORED:
            self._keep(_STORED)

    def best(self, count: int) -> tuple[Tensor, Tensor]:
        """Rotations (3, 3, F), made orthonormal to float64, and translations (3, F), best first."""
        rotation, translation, key = self._all()
        top = key.topk(min(count, len(key))).indices
        return orthonormal(rotation[..., top].double()), translation[:, top].double()

    def apart(self, source: Tensor, radius: float) -> tuple[Tensor, Tensor]:
        """Up to ``_SPREAD`` of them that put ``source`` (3, M) more than ``radius`` apart, as ``best``."""
        self._keep(self._stored)
        rotation, translation, _ = self._all()
        top = spread_out(pose_vectors(rotation, translation, source), radius, _SPREAD)
        return orthonormal(rotation[..., top].double()), translation[:, top].double()

    def _all(self) -> tuple[Tensor, Tensor, Tensor]:
        return torch.cat(self._rotation, dim=-1), torch.cat(self._translation, dim=-1), torch.cat(self._key)

    def _keep(self, count: int) -> None:
        rotation, translation, key = self._all()
        top = key.topk(min(count, len(key))).indices
        self._rotation, self._translation, self._key = [rotation[..., top]], [translation[:, top]], [key[top]]
        self._stored = len(top)


def distinct_poses(
    proposals: Proposals, source: Tensor, target: Tensor, threshold: float, rounds: int, quality: Quality
) -> Scored:
    """The distinct poses of all proposals, best first, each refitted to its inliers at most ``rounds`` times.

    Args:
        proposals: at least one hypothesis.
        source: (3, M) float64, meters.
        target: (3, M) float64.
        threshold: meters, of an inlier.
        rounds: of local optimization.
        quality: what they are compared by.
    """
    leaders = score(*proposals.best(LEADERS), source, target, threshold, quality)
    leaders = leaders.take(best_first(leaders)[:OPTIMIZED])
    others = score(*proposals.apart(source, APART * threshold), source, target, threshold, quality)
    poses = optimize(leaders.join(others), source, target, threshold, min(rounds, _FIRST_ROUNDS), quality)
    poses = _distinct(poses, source, threshold)
    poses = optimize(poses, source, target, threshold, rounds - _FIRST_ROUNDS, quality)
    return _distinct(poses, source, threshold)


def _distinct(poses: Scored, source: Tensor, threshold: float) -> Scored:
    poses = poses.take(best_first(poses))
    vectors = pose_vectors(poses.rotation, poses.translation, source)
    return poses.take(spread_out(vectors, APART * threshold, POSES))


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
