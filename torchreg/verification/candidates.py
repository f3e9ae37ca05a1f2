"""Candidate poses of a group of pairs: those that solvers proposed, which of them are distinct, and probes.

Probes are poses that an ambiguous scene supports as well: displaced along the motion that the surfaces resist least, or
turned about a principal axis. A plane, a corridor, a hall that equals itself after a half turn and a body of revolution
admit such poses, which the solvers need not have proposed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import lane_sums
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.verification.information import WeakestMotion
from torchreg.verification.model import Evidence

SLIDE, TURN = -1, -2
"""Origins of probes."""

_STEPS = (-16.0, -8.0, 8.0, 16.0)
"""Displacements along the weakest motion, in inlier thresholds: farther than poses that count as the same."""


_QUARTERS = (1, 2, 3)
"""Turns about an axis that are probed, in right angles."""

_THICK = 0.5
"""A body counts as thick as this share of its length at least, so that turns of a slim one tell poses apart."""

_WIDE = 5.6
"""And as this many inlier thresholds: a turn by 45 degrees then tells poses apart, however few points the body has."""

Record = TypeVar("Record", bound=Any)


class Run(NamedTuple):
    """The rows ``begin:end`` belong to one pair."""

    pair: int
    begin: int
    end: int


class Poses(NamedTuple):
    """H poses of G pairs: x_target = R x_source + t in the frames of the points, origins left out."""

    rotation: Tensor  # (H, 3, 3) float64
    translation: Tensor  # (H, 3) float64, meters
    origin: Tensor  # (H,) int64, which proposal each came from; probes have negative numbers
    pair: Tensor  # (H,) int64, which pair each belongs to; ascending, except between ``joined`` and an ordering

    def take(self, rows: Tensor | slice) -> Poses:
        """The poses ``rows`` (K,), in that order."""
        return Poses(*(part[rows] for part in self))

    def matrices(self) -> Tensor:
        """(H, 4, 4)."""
        return rigid(self.rotation, self.translation)

    def vectors(self, frames: Tensor) -> Tensor:
        """(12, H), whose distances are rms displacements of points, meters (``torchreg.solvers.poses.pose_vectors``).

        ``frames`` (G, 4, 3) are the columns of a root of the covariance of every pair's points, and their mean.
        """
        turned = apply_rotation(self.rotation[:, None], frames[self.pair])  # (H, 4, 3)
        turned[:, 3] += self.translation
        return turned.flatten(1).t().contiguous()


class Candidates(NamedTuple):
    """H poses with what supports them, (H,) each."""

    poses: Poses  # the poses
    evidence: Evidence  # of the clouds
    support: Tensor  # int64, inliers among the matches of the proposal whose agreement is least likely by chance
    proposal: Tensor  # int64, which proposal that is
    surprise: Tensor  # of that agreement, as a power of ten
    odds: Tensor  # log-odds of being right

    def take(self, rows: Tensor | slice) -> Candidates:
        """The poses ``rows`` (K,), in that order."""
        return Candidates(self.poses.take(rows), self.evidence.take(rows), *(values[rows] for values in self[2:]))

    def best_first(self) -> Candidates:
        """Pair by pair in order of their odds; equal ones in the order they have."""
        order = self.odds.sort(descending=True, stable=True).indices
        return self.take(order[self.poses.pair[order].sort(stable=True).indices])


class GivenPoses(NamedTuple):
    """The given pose of each of G pairs."""

    as_given: Candidates  # (G,), not refined
    refined: Candidates  # (G,), each after ICP, or as it was where that lowers its odds
    within_reach: list[int]  # of every pair, the row of its best candidate that the refined pose repeats


class Choice(NamedTuple):
    """The candidates of G pairs and how firmly the surfaces hold the best of each."""

    candidates: Candidates  # of all pairs, distinct, those of each pair best first; at least one each
    information: Tensor  # (G, 6, 6) float64 of the best poses, Open3D's convention, in the frames of the targets' files
    motion: WeakestMotion  # the weakest motions under the best poses
    given: GivenPoses | None  # where poses were given


class PointMoments(NamedTuple):
    """The moments of the points of G scans."""

    mean: Tensor  # (G, 3) float64, meters
    products: Tensor  # (G, 3, 3) float64, sums of products of distances to the mean, square meters
    counts: Tensor  # (G,) float64, points


def joined(parts: Sequence[Record]) -> Record:
    """All rows of the parts, in order: named tuples of tensors, or of such tuples, concatenated field by field."""
    fields = [
        joined(values) if isinstance(values[0], tuple) else torch.cat(values) for values in zip(*parts, strict=True)
    ]
    record: Record = type(parts[0])(*fields)
    return record


def runs_of(pair: Tensor) -> list[Run]:
    """Where the rows of each pair stand, by their pairs (H,), ascending; pairs without rows have no run."""
    begin, runs = 0, []
    for number, members in groupby(pair.tolist()):
        end = begin + len(list(members))
        runs.append(Run(number, begin, end))
        begin = end
    return runs


def distinct(vectors: Tensor, pair: Tensor, apart: Tensor) -> list[int]:
    """Rows of the poses that move their points farther than ``apart`` from all that are kept before them.

    As ``solvers.poses.spread_out``, with vectors (12, H), pairs (H,) and a distance of every pair, ``apart`` (G,). All
    poses of a pair are compared at once: for so few, one by one, as the solvers do it, takes ten times longer.
    """
    runs = runs_of(pair)
    most = max(run.end - run.begin for run in runs)
    first = torch.tensor([run.begin for run in runs], device=pair.device)
    # rows of the last pose where a pair has fewer: they are never read
    rows = (first[:, None] + torch.arange(most, device=pair.device)).clamp(max=len(pair) - 1)  # (g, most)
    square = torch.zeros(*rows.shape, most, dtype=vectors.dtype, device=pair.device)
    for line in vectors.unbind(0):
        difference = line[rows][:, None] - line[rows][:, :, None]
        square += difference * difference
    kept = []
    for run, far in zip(runs, (square > apart[pair[first], None, None].square()).tolist(), strict=True):
        left = list(range(run.end - run.begin))
        while left:
            best = left[0]
            kept.append(run.begin + best)
            left = [other for other in left[1:] if far[best][other]]
    return kept


def point_moments(points: Tensor, valid: Tensor, counts: Tensor) -> PointMoments:
    """The moments of points (3, G, L), filled up where not ``valid`` (G, L); ``counts`` (G,) float64 of each scan."""
    wide, count = points.double(), counts.clamp(min=1)
    mean = lane_sums(wide) / count  # (3, G)
    apart = torch.where(valid, wide - mean[..., None], 0.0)
    products = lane_sums(torch.stack([apart[i] * apart for i in range(3)]))  # (3, 3, G)
    return PointMoments(mean.t(), products.permute(2, 0, 1), count)


def frames(moments: PointMoments, threshold: Tensor) -> Tensor:
    """(G, 4, 3): the columns of a root of each covariance, then the mean, as ``Poses.vectors`` takes them.

    A body whose points a turn about its axis hardly moves, since it is slim or small beside the inlier thresholds (G,),
    counts as thicker than it is.
    """
    values, vectors = torch.linalg.eigh(moments.products / moments.counts[:, None, None])
    deviations = values.clamp(min=0).sqrt()  # (G, 3), ascending
    least = torch.maximum(_THICK * deviations[:, 2:], _WIDE * threshold[:, None])
    root = vectors * torch.maximum(deviations, least)[:, None]
    return torch.cat([root.transpose(1, 2), moments.mean[:, None]], dim=1)


def slides(pose: Poses, weakest: WeakestMotion, threshold: Tensor) -> Poses:
    """One pose of each of G pairs displaced along its weakest motion, both ways: 4 each; thresholds (G,) in meters."""
    steps = torch.tensor(_STEPS, dtype=torch.float64, device=threshold.device)
    length = (steps * threshold[:, None])[..., None]  # (G, 4, 1)
    turn = _rotations(weakest.turn[:, None] * length)  # (G, 4, 3, 3)
    return _probes(pose, SLIDE, turn, weakest.center, weakest.shift[:, None] * length)


def turns(pose: Poses, target: PointMoments) -> Poses:
    """One pose of each of G pairs after quarter and half turns about the principal axes of the target: 9 each."""
    _, axes = torch.linalg.eigh(target.products)  # columns
    turn = quarter_turns(axes.transpose(1, 2))
    return _probes(pose, TURN, turn, target.mean, torch.zeros_like(turn[..., 0]))


def quarter_turns(axes: Tensor) -> Tensor:
    """The rotations (..., 9, 3, 3) by one, two and three right angles about three axes each, unit rows (..., 3, 3)."""
    axis = axes[..., None, :]  # (..., 3, 1, 3): axis by axis
    eye = torch.eye(3, dtype=axis.dtype, device=axis.device)
    zero = torch.zeros_like(axis[..., 0])
    x, y, z = axis.unbind(-1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    square = axis[..., :, None] * axis[..., None, :] - eye  # of cross
    sine, cosine = ((0.0, 1.0, 0.0, -1.0), (1.0, 0.0, -1.0, 0.0))
    turned = [eye + sine[quarter] * cross + (1 - cosine[quarter]) * square for quarter in _QUARTERS]
    return torch.cat(turned, dim=-3).flatten(-4, -3)


def _probes(pose: Poses, kind: int, turn: Tensor, center: Tensor, shift: Tensor) -> Poses:
    """G poses, each turned by (G, K, 3, 3) about its center (G, 3), then shifted by (G, K, 3); pose by pose."""
    center = center[:, None]
    rotation = _product(turn, pose.rotation[:, None])
    translation = apply_rotation(turn, pose.translation[:, None] - center) + center + shift
    pair = pose.pair[:, None].expand(turn.shape[:2]).flatten()
    return Poses(rotation.flatten(0, 1), translation.flatten(0, 1), torch.full_like(pair, kind), pair)


def _product(one: Tensor, other: Tensor) -> Tensor:
    """Matrix products (..., 3, 3), without a routine whose order of addition could depend on their number."""
    return (one[..., :, :, None] * other[..., None, :, :]).sum(dim=-2)


def _rotations(vectors: Tensor) -> Tensor:
    """The rotations (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    angle = vectors.square().sum(dim=-1).sqrt()
    x, y, z = (vectors / angle[..., None].clamp(min=1e-300)).unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    eye = torch.eye(3, dtype=vectors.dtype, device=vectors.device)
    # one by one, since a sine rounds differently at the end of a range
    single = angle.flatten().unbind(0)
    sine, cosine = (torch.stack([function(each) for each in single]) for function in (torch.sin, torch.cos))
    sine, cosine = (each.view(angle.shape)[..., None, None] for each in (sine, cosine))
    rotations: Tensor = eye + sine * cross + (1 - cosine) * _product(cross, cross)
    return rotations
