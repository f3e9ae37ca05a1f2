"""Poses from congruent sets, and how many points of the source lie on the target under each (the largest common
pointset).

Every set gives a pose by the least-squares rotation of its four corners. Poses are sifted in steps, each of which looks
closer at fewer: whether the corners come together and their normals agree, in how many cells near the target a few
points of the source come to lie, and last how many points have a partner that faces the same way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.congruent.bases import Bases
from torchreg.congruent.sets import CongruentSets
from torchreg.congruent.sides import CloudSide, Tolerances, dot
from torchreg.geometry.best_rotation import best_rotation, best_translation
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather_columns
from torchreg.solvers.poses import pose_vectors, spread_out
from torchreg.verification.partners import PartnerSearch, near_counts, partners

_ELEMENTS = 1 << 18  # points moved at once
_CORNERS = 1 << 16  # sets whose rotations are solved at once
_FEW = 128  # points of the source that all poses are counted on
_MANY = 1000  # those that the best are counted on
_KEPT = 512  # poses that stay after the first count
_PARTS = 1 << 10  # that a point's worth is counted in


class ScoredPoses(NamedTuple):
    """H poses, x_target = R x_source + t about the centers of both sides."""

    rotation: Tensor  # (3, 3, H) float64
    translation: Tensor  # (3, H) float64, meters
    score: Tensor  # (H,) float64 in [0, 1], the higher, the better

    def take(self, rows: Tensor) -> ScoredPoses:
        """The poses ``rows`` (K,), in that order."""
        return ScoredPoses(self.rotation[..., rows], self.translation[:, rows], self.score[rows])

    def best(self, count: int) -> ScoredPoses:
        """The first ``count`` by score, ties to the earlier."""
        return self.take(self.score.sort(descending=True, stable=True).indices[:count])


class CommonPoints:
    """Counts points of the source that lie on the target."""

    def __init__(self, source: CloudSide, target: CloudSide, within: Tolerances) -> None:
        number = source.points.shape[1]
        self._source, self._target, self._within = source, target, within
        limit = torch.tensor([within.meters], dtype=torch.float64, device=source.points.device)
        self._search = PartnerSearch(target.points, [target.points.shape[1]], limit)
        self._few, self._many = (
            torch.arange(min(most, number), device=source.points.device) * number // min(most, number)
            for most in (_FEW, _MANY)
        )

    def roughly(self, poses: ScoredPoses) -> ScoredPoses:
        """The poses scored by how many of a few points come near the target."""
        return poses._replace(score=self._counted(poses, self._few, self._near))

    def exactly(self, poses: ScoredPoses) -> ScoredPoses:
        """The poses scored by how closely many points come to partners that face the same way."""
        return poses._replace(score=self._counted(poses, self._many, self._facing))

    def _counted(self, poses: ScoredPoses, rows: Tensor, count: Callable[[Tensor, Tensor, Tensor], Tensor]) -> Tensor:
        parts = [poses.score[:0]]
        for part in row_chunks(len(poses.score), len(rows), _ELEMENTS):
            rotation = poses.rotation[..., part].float()
            moved = moved_by(rotation, poses.translation[:, part].float(), self._source.points[:, rows])
            parts.append(count(moved, rotation, rows))
        return torch.cat(parts)

    def _near(self, moved: Tensor, rotation: Tensor, rows: Tensor) -> Tensor:
        pair = torch.zeros(moved.shape[1], dtype=torch.int64, device=moved.device)
        valid = torch.ones(moved.shape[1:], dtype=torch.bool, device=moved.device)
        return near_counts(self._search.occupancy, pair, moved, valid).double() / len(rows)

    def _facing(self, moved: Tensor, rotation: Tensor, rows: Tensor) -> Tensor:
        pair = torch.zeros(moved.shape[1], dtype=torch.int64, device=moved.device)
        valid = torch.ones(moved.shape[1:], dtype=torch.bool, device=moved.device)
        limit = torch.full((moved.shape[1],), self._within.meters**2, dtype=torch.float32, device=moved.device)
        found = partners(self._search, pair, moved, valid, limit)
        close = found.square < limit[:, None]
        worth = torch.where(close, 1 - found.square / limit[:, None], 0.0)
        if self._source.normals is not None and self._target.normals is not None and self._within.normals < math.pi:
            turned = moved_by(rotation, torch.zeros_like(rotation[0]), self._source.normals[:, rows])
            cosine = dot(turned, gather_columns(self._target.normals, found.row))
            cosine = cosine if self._within.signed else cosine.abs()
            worth = torch.where(cosine >= math.cos(min(self._within.normals, math.pi / 2)), worth * cosine, 0.0)
        # as whole numbers, whose sum is the same in any order
        return (worth * _PARTS).round().long().sum(dim=1).double() / (_PARTS * len(rows))


def moved_by(rotation: Tensor, translation: Tensor, points: Tensor) -> Tensor:
    """(3, H, N) of rotations (3, 3, H), translations (3, H) and points (3, N)."""
    x, y, z = points
    return torch.stack(
        [
            rotation[i, 0, :, None] * x
            + rotation[i, 1, :, None] * y
            + rotation[i, 2, :, None] * z
            + translation[i, :, None]
            for i in range(3)
        ]
    )


def poses_of_sets(
    source: CloudSide,
    target: CloudSide,
    bases: Bases,
    sets: Iterable[CongruentSets],
    within: Tolerances,
    counter: CommonPoints,
) -> tuple[ScoredPoses, int, int]:
    """The best poses of all sets by a rough count, how many sets there were, and how many of them gave a pose."""
    best = no_poses(source.points.device)
    found = fitting = 0
    for part in sets:
        found += len(part.base)
        for rows in row_chunks(len(part.base), 1, _CORNERS):
            poses = _solved(source, target, bases, CongruentSets(part.base[rows], part.corners[:, rows]), within)
            fitting += len(poses.score)
            best = joined(best, counter.roughly(poses)).best(_KEPT)
    return best, found, fitting


def distinct(poses: ScoredPoses, source: CloudSide, radius: float, count: int) -> ScoredPoses:
    """At most ``count`` poses, best first, that move the source apart by ``radius``, meters, root mean square."""
    poses = poses.best(len(poses.score))
    vectors = pose_vectors(poses.rotation, poses.translation, source.points.double())
    pair = torch.zeros(len(poses.score), dtype=torch.int64, device=poses.score.device)
    return poses.take(spread_out(vectors, pair, [radius], count))


def joined(one: ScoredPoses, other: ScoredPoses) -> ScoredPoses:
    """Those of both, in order."""
    return ScoredPoses(*(torch.cat(parts, dim=-1) for parts in zip(one, other, strict=True)))


def no_poses(device: torch.device) -> ScoredPoses:
    """Poses of which there are none."""
    zero = torch.zeros(0, dtype=torch.float64, device=device)
    return ScoredPoses(zero.reshape(3, 3, 0), zero.reshape(3, 0), zero)


def _solved(source: CloudSide, target: CloudSide, bases: Bases, sets: CongruentSets, within: Tolerances) -> ScoredPoses:
    """The poses of sets whose corners come together and face the same way."""
    mine = bases.corners[:, sets.base]  # (4, S)
    p, q = source.points[:, mine].double(), target.points[:, sets.corners].double()  # (3, 4, S)
    p_mean, q_mean = _mean(p), _mean(q)
    p_apart, q_apart = p - p_mean[:, None], q - q_mean[:, None]
    products = p_apart[:, None] * q_apart[None]  # (3, 3, 4, S)
    rotation = best_rotation(products[:, :, 0] + products[:, :, 1] + products[:, :, 2] + products[:, :, 3])
    moved = _turned(rotation, p_apart) - q_apart
    fits = dot(moved, moved).amax(dim=0) <= within.meters**2
    if source.normals is not None and target.normals is not None and within.normals < math.pi:
        cosine = dot(_turned(rotation, source.normals[:, mine].double()), target.normals[:, sets.corners].double())
        cosine = cosine if within.signed else cosine.abs()
        fits &= cosine.amin(dim=0) >= math.cos(within.normals)
    rows = fits.nonzero()[:, 0]
    rotation = rotation[..., rows]
    translation = best_translation(rotation, p_mean[:, rows], q_mean[:, rows])
    return ScoredPoses(rotation, translation, torch.zeros(len(rows), dtype=torch.float64, device=rows.device))


def _turned(rotation: Tensor, vectors: Tensor) -> Tensor:
    """R (3, 3, S) times (3, 4, S)."""
    x, y, z = vectors
    return torch.stack([rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z for i in range(3)])


def _mean(corners: Tensor) -> Tensor:
    return (corners[:, 0] + corners[:, 1] + corners[:, 2] + corners[:, 3]) / 4
