"""Whether a reflection, or a similarity with a factor, explains clearly more matches of one pair than any rigid motion.

Lengths are blind to handedness: mirrored through any plane, here x -> -x, the points of a mirrored pair are a rigid
problem. A factor is first read from the ratios of lengths (``length_ratios``); with the source at that size the problem
is rigid as well, and a weighted fit alternates with the weights w_i that its residuals give: the rotation R of Kabsch,

    s = (sum_i w_i |q_i - q|^2 / sum_i w_i |p_i - p|^2)^(1/2),    t = q - s R p,

the factor of Horn (J. Opt. Soc. Am. A 4(4), 1987, doi:10.1364/JOSAA.4.000629), which equals that of Umeyama (PAMI
13(4), 1991, doi:10.1109/34.88573) up to the noise and becomes its inverse where source and target are swapped.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.kabsch import from_moments
from torchreg.geometry.numerics.sums import lane_sums
from torchreg.geometry.se3 import apply_rotation
from torchreg.solvers import CompatibilityOptions, poses_of_pairs
from torchreg.types import Clouds, Correspondences
from torchreg.verification.agreement import MatchEndpoints, agreement, match_cells
from torchreg.verification.length_ratios import LengthRatios, length_ratios

_CLEARLY = 1.2  # times the support of the best rigid pose that a similarity needs
_LOST = 4.0  # matches gained for one that only the rigid pose brings together
_GAINED = 0.1  # of the matches
_GAINED_SCALED = 0.05  # of the matches, by a factor
_GAINED_TURNED = 0.05  # of the matches, where the best rigid pose puts surfaces back to back
_MIRRORED = 0.15  # of the matches that a reflection needs; facades whose rigid pose is right have up to 0.1
_PROMISING = 0.9  # of a support that would do: lengths imply somewhat less than there is
_MIRRORED_SURPRISE = 30.0  # powers of ten above that of the best rigid pose; facades that are right have up to 22
_SCALED_SURPRISE = 25.0  # likewise; up to 8
_SURE = 300.0  # powers of ten that suffice in any case: figures end at 400
_FACTOR = 0.01  # a factor nearer to 1 is within what scanners and photogrammetry leave
_DEVIATIONS = 3.0
_NODES = 500  # matches that a pose is sought from
_ROUNDS = 10
_CLOSE = 0.5  # of the threshold: matches farther apart have no weight in the factor
_CELL = 3.5  # thresholds: matches of one such cell count as one measurement, as in ``agreement``


class RigidFit(NamedTuple):
    """The best rigid pose of one pair, by what supports it."""

    inliers: Tensor  # (M,) bool, matches within the threshold
    surprise: float  # powers of ten, as of ``Agreement``
    facing: float = 1.0  # mean cosine of the normals of partners, as of ``Evidence``

    @property
    def gained(self) -> float:
        """The share of the matches that a reflection has to gain over this pose.

        A flat scene equals its mirror image but for what stands out of it. A rigid pose then turns it over, and
        surfaces that scanners saw from one side come to lie back to back: so less has to speak for the reflection.
        """
        return _GAINED_TURNED if self.facing < 0 else _GAINED


class Mirrored(NamedTuple):
    """A reflection explains the matches."""

    support: int  # matches that agree under it


class Scaled(NamedTuple):
    """A similarity explains the matches."""

    factor: float  # lengths in the target over lengths in the source
    deviation: float  # the standard deviation of the factor
    support: int  # matches that agree under it


def impossible_as_rigid(source: Tensor, target: Tensor, threshold: float, rigid: RigidFit) -> Mirrored | Scaled | None:
    """Find what explains the matches of one pair where no rigid pose does.

    Args:
        source: (M, 3) float64, meters, matched points.
        target: (M, 3) float64, meters, row by row the points matched to them.
        threshold: meters, of an inlier.
        rigid: what supports the best rigid pose among these matches.

    Returns:
        The finding; ``None`` where a rigid pose explains as much, or nearly so. A scene that equals its mirror image,
        seen from its two sides with little in common, looks like a mirrored one.
    """
    count = len(source)
    if count < 2 or count - int(rigid.inliers.sum()) < rigid.gained * count:  # too few are left to be gained
        return None
    ratios = length_ratios(source, target, threshold)
    return mirrored(source, target, threshold, rigid, ratios) or scaled(source, target, threshold, rigid, ratios)


def mirrored(
    source: Tensor, target: Tensor, threshold: float, rigid: RigidFit, ratios: LengthRatios
) -> Mirrored | None:
    """Whether a reflection explains the matches; arguments as of ``impossible_as_rigid``, and their length ratios."""
    count = len(source)
    needed = max(int(rigid.inliers.sum()) + rigid.gained * count, _MIRRORED * count)
    if ratios.support_at_one < _PROMISING * needed:
        return None
    through = source * torch.tensor([-1.0, 1.0, 1.0], dtype=source.dtype, device=source.device)
    pose = _best_pose(through, target, threshold)
    if pose is None:
        return None
    fit = _Similarity(1.0, *pose)
    support = int(_inliers(through, target, threshold, fit).sum())
    clear = _explains_more(through, target, threshold, fit, rigid, rigid.gained, _MIRRORED_SURPRISE)
    return Mirrored(support) if clear and support >= _MIRRORED * count else None


def scaled(source: Tensor, target: Tensor, threshold: float, rigid: RigidFit, ratios: LengthRatios) -> Scaled | None:
    """Whether a similarity explains the matches; arguments as of ``mirrored``."""
    count, explained = len(source), int(rigid.inliers.sum())
    if ratios.factor == 1 or ratios.support < _PROMISING * max(explained, _GAINED * count):
        return None
    pose = _best_pose(source * ratios.factor, target, threshold)
    if pose is None:
        return None
    fit = _refined(source, target, threshold, _Similarity(ratios.factor, *pose))
    support = int(_inliers(source, target, threshold, fit).sum())
    clear = _explains_more(source, target, threshold, fit, rigid, _GAINED_SCALED, _SCALED_SURPRISE)
    if support < _CLEARLY * explained or not clear:
        return None
    deviation = _deviation(source, target, threshold, fit)
    if abs(fit.factor - 1) <= max(_FACTOR, _DEVIATIONS * deviation):
        return None
    return Scaled(fit.factor, deviation, support)


class _Similarity(NamedTuple):
    """x_target = s R x_source + t."""

    factor: float
    rotation: Tensor  # (3, 3) float64
    translation: Tensor  # (3,) float64, meters


def _explains_more(
    source: Tensor,
    target: Tensor,
    threshold: float,
    fit: _Similarity,
    rigid: RigidFit,
    least_gained: float,
    above: float,
) -> bool:
    """Whether a fit gains that share of the matches, loses few that the rigid pose has, and agrees far beyond chance.

    A wrong rigid pose of a mirrored or scaled pair agrees where it equals the reflection, near a plane, or the
    similarity, about a point. A right one brings matches together that no reflection does.
    """
    inliers = _inliers(source, target, threshold, fit)
    gained, lost = int((inliers & ~rigid.inliers).sum()), int((rigid.inliers & ~inliers).sum())
    if gained < max(least_gained * len(source), _LOST * lost):
        return False
    cells = match_cells(MatchEndpoints(source * fit.factor, target), threshold)
    surprise = float(agreement(cells, fit.rotation[None], fit.translation[None]).surprise[0])
    return surprise >= min(_SURE, rigid.surprise + above)


def _best_pose(source: Tensor, target: Tensor, threshold: float) -> tuple[Tensor, Tensor] | None:
    """Rotation and translation of the best rigid pose by an even choice of the matches; ``None`` without any."""
    step = -(-len(source) // _NODES)
    sides = [Clouds(points=side[::step].contiguous()) for side in (source, target)]
    rows = torch.arange(len(sides[0].points), device=source.device)
    matches = Correspondences(rows, rows, torch.tensor([0, len(rows)]), torch.zeros(len(rows), device=source.device))
    solver = CompatibilityOptions(inlier_threshold=threshold, nodes=_NODES)
    poses = poses_of_pairs(sides[0], sides[1], matches, [solver])[0]
    return None if len(poses.support) == 0 else (poses.rotation[0], poses.translation[0])


def _residuals(source: Tensor, target: Tensor, fit: _Similarity) -> Tensor:
    """Squared distances (M,) under a similarity, square meters of the target."""
    return _square((apply_rotation(fit.rotation, source * fit.factor) + fit.translation - target).t())


def _inliers(source: Tensor, target: Tensor, threshold: float, fit: _Similarity) -> Tensor:
    """(M,) bool."""
    return _residuals(source, target, fit) < threshold * threshold


def _refined(source: Tensor, target: Tensor, threshold: float, fit: _Similarity) -> _Similarity:
    """The similarity fitted to its inliers until they stay the same, then to the closest of them.

    A feature next to an edge is matched to the place at the same distance from the edge, not at the same share of the
    wall. Such matches are off by a part of the threshold and pull the factor to one side, so they get little weight.
    """
    inliers = _inliers(source, target, threshold, fit)
    for _ in range(_ROUNDS):
        fit = _fitted(source, target, inliers.double(), fit)
        before, inliers = inliers, _inliers(source, target, threshold, fit)
        if torch.equal(before, inliers):
            break
    for _ in range(_ROUNDS):
        fit = _fitted(source, target, _weights(source, target, threshold, fit), fit)
    return fit


def _weights(source: Tensor, target: Tensor, threshold: float, fit: _Similarity) -> Tensor:
    """Tukey's biweight (M,) of the residuals r, (1 - |r|^2 / c^2)^2, zero from c, half the threshold, on."""
    return _within(source, target, threshold, fit).square()


def _within(source: Tensor, target: Tensor, threshold: float, fit: _Similarity) -> Tensor:
    return (1 - _residuals(source, target, fit) / (_CLOSE * threshold) ** 2).clamp(min=0)


def _fitted(source: Tensor, target: Tensor, weights: Tensor, former: _Similarity) -> _Similarity:
    """The similarity that fits matches of these weights (M,) best; the former one where they determine none."""
    (p_mean, p), (q_mean, q) = _centered(source, weights), _centered(target, weights)
    p_spread, q_spread = (_total(weights * _square(side)) for side in (p, q))
    if not min(p_spread, q_spread) > 0:
        return former
    covariance = lane_sums((weights * p[:, None] * q[None]).flatten(0, 1)).reshape(3, 3)
    rotation = from_moments(p_mean, q_mean, covariance)[:3, :3]
    factor = math.sqrt(q_spread / p_spread)
    return _Similarity(factor, rotation, q_mean - apply_rotation(rotation, factor * p_mean))


def _deviation(source: Tensor, target: Tensor, threshold: float, fit: _Similarity) -> float:
    """The standard deviation of the factor, that of an M-estimator (Huber, Robust Statistics, 1981, section 6.3).

    With u = |r|^2 / c^2 and w = (1 - u)^2, an error e along R p counts by w e and, to first order, by the derivative
    w - 4/3 u (1 - u), a mean over the directions of e:

        var(s) = sum w^2 |p|^2 |r|^2 / 3  /  (sum (w - 4/3 u (1 - u)) |p|^2)^2

    Matches of one place have one error in common: so places count, not matches.
    """
    within = _within(source, target, threshold, fit)
    weights, used = within.square(), within > 0
    square = _square(_centered(source, weights)[1])
    slope = torch.where(used, weights - 4 / 3 * (1 - within) * within, 0.0)
    held = max(_total(slope * square), 0.1 * _total(weights * square))  # where residuals are wide, not much is
    places = len(torch.floor(source[used] * (fit.factor / (_CELL * threshold))).unique(dim=0))
    if places == 0 or not held > 0:
        return math.inf
    variance = _total(weights * weights * square * _residuals(source, target, fit)) / (3 * held * held)
    return math.sqrt(variance * int(used.sum()) / places)


def _centered(points: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """The weighted mean (3,) of points (M, 3), and the points about it, (3, M)."""
    columns = points.t()
    total = _total(weights)
    mean = lane_sums(weights * columns) / (total if total > 0 else 1.0)
    return mean, columns - mean[:, None]


def _square(columns: Tensor) -> Tensor:
    """Squared lengths (M,) of vectors (3, M)."""
    return columns[0] * columns[0] + columns[1] * columns[1] + columns[2] * columns[2]


def _total(values: Tensor) -> float:
    """The sum of (M,), in a fixed order."""
    return float(lane_sums(values[None])[0])
