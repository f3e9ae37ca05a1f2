"""Refine poses on surfels, take back what the surfaces do not hold, and keep a pose that would become worse.

A settled pose is an estimate with a covariance; so is the pose it started from, whose error is about a part of the
threshold that it was found at. The two are joined by their covariances, as a Kalman filter joins a prediction and a
measurement: where surfaces hold the pose, the settled one counts, and where it slides, the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.partition import partition
from torchreg.geometry.numerics.threads import shared_out
from torchreg.native import kernel_threads
from torchreg.refinement.certainty import Certainty, agreeing, certainty, residuals
from torchreg.refinement.pairing import Pairing, enter, leave
from torchreg.refinement.settle import Settling, SurfelPairs
from torchreg.refinement.spread import FAINT
from torchreg.refinement.surfels import Surfels

_START = 0.15  # of the reach: the deviation of a pose to start from, at the size of the source
_FARTHEST = 0.8  # of the reach, that a pose may move
_FEWER = 0.8  # of the surfels that lay on each other before, at least
_ALIKE = 0.8  # of the contrast, that the intensities of partners differ by at most: a correlation of 0.7
_SLIDES = 0.05  # of the strength by axis: below it colors take part
_GROUP = 200_000  # surfels of the sources of a group

FEW = "too few flat places to refine it on"
OPEN = "the flat places of the overlap leave its motion open"
FARTHER = "flat places would move it by about the inlier threshold"
COLORLESS = "colors do not tell more"
WORSE = "fewer flat places would lie on each other"


class Refined(NamedTuple):
    """The poses of B pairs after refinement. NaN stands for figures that a pair has not."""

    T_target_source: Tensor  # (B, 4, 4) float64, origins included
    reason: tuple[str, ...]  # why a pose is the one it started from; empty where it was refined
    residuals: Tensor  # (B, 3) meters: median, root mean square, 95th percentile of the surfels' distances to planes
    covariance: Tensor  # (B, 6, 6) of a small turn (radians) about ``center`` and a shift (meters), target's frame
    center: Tensor  # (B, 3) meters, in the target's frame, origin included: the middle of the overlap
    held: Tensor  # (B, 6) in [0, 1]: how firmly turns about x, y, z and shifts along them are held


def refine_on_surfels(
    source: Surfels,
    target: Surfels,
    T_target_source: Tensor,
    reach: Sequence[float],
    skipped: Sequence[bool],
    sizes: Sequence[float] | None = None,
) -> Refined:
    """Refine the poses of B pairs.

    Args:
        source: surfels of B clouds.
        target: likewise.
        T_target_source: (B, 4, 4) float64, rigid, origins included: about right.
        reach: B numbers, meters: how far off a pose may be.
        skipped: B flags: pairs that stay as they are, without figures.
        sizes: B numbers, meters: root mean square distances of the source's points from their mean. A pose is off by a
            part of ``reach`` there, so it is turned by less, the larger they are; ``None`` takes those of the surfels,
            which may all lie in the floor around a scanner.

    Returns:
        Refined. A pair's figures have the same bits alone, in any batch and with any number of threads.
    """
    pairs = len(source)
    sources, targets = source.unpack(), target.unpack()
    lengths = [len(one.cloud.points) for one in sources]
    ready = [b for b in range(pairs) if not skipped[b] and min(lengths[b], len(targets[b].cloud.points)) > 0]
    groups = [ready[part] for part in partition([lengths[b] for b in ready], _GROUP)] if ready else []
    workers = kernel_threads() if source.cloud.device.type == "cpu" else 1
    if len(ready) > 1 and workers > 1:
        groups = [ready[first::workers] for first in range(min(workers, len(ready)))]

    def run(members: list[int]) -> list[_One]:
        sides = Surfels.pack([sources[b] for b in members]), Surfels.pack([targets[b] for b in members])
        of_points = [0.0 if sizes is None else sizes[b] for b in members]
        return _refine(*sides, T_target_source[members], [reach[b] for b in members], of_points)

    done = shared_out(run, groups, workers) if len(groups) > 1 else list(map(run, groups))
    by_pair: dict[int, _One] = {}
    for members, group in zip(groups, done, strict=True):
        by_pair.update(zip(members, group, strict=True))
    every = [by_pair.get(b) or _unrefined(T_target_source[b], "" if skipped[b] else FEW) for b in range(pairs)]
    fields = list(zip(*every, strict=True))
    return Refined(torch.stack(fields[0]), fields[1], *(torch.stack(field) for field in fields[2:]))


def residuals_under(source: Surfels, target: Surfels, T_target_source: Tensor, skipped: Sequence[bool]) -> Tensor:
    """Residuals (B, 3), meters, as ``Refined`` has them, under transforms (B, 4, 4) as they are; NaN where skipped."""
    out = T_target_source.new_full((len(source), 3), torch.nan)
    for b, (one, other) in enumerate(zip(source.unpack(), target.unpack(), strict=True)):
        if not skipped[b] and min(len(one.cloud.points), len(other.cloud.points)) > 0:
            pairs = SurfelPairs(one, other, Pairing([0], [0]))
            seen = pairs.seen(*enter(pairs.frames, T_target_source[b : b + 1]))
            out[b] = residuals(seen, 0)
    return out


class _One(NamedTuple):
    """As ``Refined``, of one pair."""

    T: Tensor
    reason: str
    residuals: Tensor
    covariance: Tensor
    center: Tensor
    held: Tensor


def _unrefined(T: Tensor, reason: str) -> _One:
    nothing = T.new_full((), torch.nan)
    return _One(T, reason, nothing.expand(3), nothing.expand(6, 6), nothing.expand(3), nothing.expand(6))


def _refine(source: Surfels, target: Surfels, T: Tensor, reach: Sequence[float], sizes: Sequence[float]) -> list[_One]:
    """By planes; a pose that slides on them by colors too, where both clouds have them."""
    made = _laid(source, target, T, reach, sizes)
    sliding = [b for b, one in enumerate(made) if one.reason == OPEN or bool((one.held < _SLIDES).any())]
    if not sliding or source.cloud.colors is None or target.cloud.colors is None:
        return made
    sources, targets = source.unpack(), target.unpack()
    sides = Surfels.pack([sources[b] for b in sliding]), Surfels.pack([targets[b] for b in sliding])
    lengths = ([values[b] for b in sliding] for values in (reach, sizes))
    again = _laid(*sides, torch.stack([made[b].T for b in sliding]), *lengths, colored=True)
    for b, one in zip(sliding, again, strict=True):
        if not one.reason:
            made[b] = one
    return made


def _laid(
    source: Surfels,
    target: Surfels,
    T: Tensor,
    reach: Sequence[float],
    sizes: Sequence[float],
    *,
    colored: bool = False,
) -> list[_One]:
    pairs = SurfelPairs(source, target, Pairing(range(len(source)), range(len(source))), colored=colored)
    pairs.sizes = torch.maximum(pairs.sizes, torch.tensor(sizes, dtype=torch.float64, device=T.device))
    R, t = enter(pairs.frames, T)
    limit = torch.tensor(reach, dtype=torch.float64, device=T.device)
    settled = pairs.settle(R, t, limit)
    before = pairs.seen(R, t, settled.spread)
    known = [certainty(settled, b, float(pairs.spacing[b])) for b in range(len(source))]
    reasons = [_objection(solvable, one) for solvable, one in zip(settled.solvable, known, strict=True)]
    rotation, translation, covariance = R.clone(), t.clone(), [one.covariance for one in known]
    for b, one in enumerate(known):
        if not reasons[b]:
            pose = (settled.rotation[b], settled.translation[b])
            (rotation[b], translation[b]), covariance[b] = _joined(
                (R[b], t[b]), pose, one, _START * float(limit[b]), pairs.sizes[b]
            )
    moved = pairs.displacement(range(len(source)), rotation, translation, R, t)
    poses, middle = leave(pairs.frames, rotation, translation), pairs.frames.target_center + pairs.frames.target_origin
    made = []
    for b, one in enumerate(known):
        if colored and not _colors_agree(settled, b):
            reasons[b] = COLORLESS
        elif not reasons[b] and bool(moved[b] > _FARTHEST * limit[b]):
            reasons[b] = FARTHER
        elif not reasons[b] and agreeing(settled, b) < _FEWER * agreeing(before, b):
            reasons[b] = WORSE
        figures = (one.residuals, covariance[b], one.center + middle[b], one.held)
        made.append(_unrefined(T[b], reasons[b]) if reasons[b] else _One(poses[b], "", *figures))
    return made


def _colors_agree(settled: Settling, b: int) -> bool:
    """Whether the intensities of pair ``b`` vary, and those of partners are alike in this."""
    shades, deviation = settled.residuals.shades, settled.spread.shade
    if shades is None or deviation is None:
        return False
    return bool((deviation[b] >= FAINT) & (deviation[b] < _ALIKE * shades.contrast[b]))


def _objection(solvable: bool, known: Certainty) -> str:
    """Why a settled pose is no estimate at all, empty where it is one."""
    if not solvable:
        return OPEN
    if not bool(torch.isfinite(known.residuals).all()):
        return FEW
    return "" if bool(torch.isfinite(known.covariance).all()) else OPEN


Pose = tuple[Tensor, Tensor]
"""R (3, 3) and t (3,), float64, between the centered frames."""


def _joined(start: Pose, settled: Pose, known: Certainty, deviation: float, size: Tensor) -> tuple[Pose, Tensor]:
    """The pose between start and settled that their covariances make the most likely, and its covariance."""
    far = torch.maximum(known.size, size)  # the pose was found on the whole clouds, not on their flat places alone
    prior = torch.cat([(deviation / far).square().expand(3), torch.full_like(known.center, deviation**2)])
    unit = prior.sqrt()  # both covariances in units of the start's, where that is the identity
    own = known.covariance / unit[:, None] / unit
    values, vectors = torch.linalg.eigh(own)
    values = values.clamp(min=0)
    covariance = (vectors * (values / (1 + values))) @ vectors.t() * unit[:, None] * unit
    turned = (settled[0][:, None] * start[0]).sum(dim=2)  # R_settled R_start^T
    between = _turned(turned, known.center - start[1]) + settled[1] - known.center
    back = torch.cat([_rotation_vector(turned), between]) / unit
    kept = (vectors * (1 / (1 + values))) @ (vectors.t() @ back) * unit
    turn = torch.linalg.matrix_exp(_cross(kept[:3]))
    shifted = _turned(turn, start[1] - known.center) + known.center + kept[3:]
    return ((turn[:, :, None] * start[0]).sum(dim=1), shifted), covariance


def _turned(R: Tensor, vector: Tensor) -> Tensor:
    return (R * vector).sum(dim=1)


def _cross(a: Tensor) -> Tensor:
    zero = torch.zeros_like(a[0])
    return torch.stack([zero, -a[2], a[1], a[2], zero, -a[0], -a[1], a[0], zero]).view(3, 3)


def _rotation_vector(R: Tensor) -> Tensor:
    """The axis times the angle (3,), radians, of a rotation (3, 3) by far less than a half turn."""
    axis = torch.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine = axis.norm()
    angle = torch.atan2(sine, (R.diagonal().sum() - 1) / 2)
    return axis * torch.where(sine > 1e-12, angle / sine.clamp(min=1e-12), 1.0)
