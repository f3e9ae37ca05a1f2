"""Of many correspondences, those that agree with more others than by chance.

Among 20,000 correspondences 20 inliers agree with each other, and with a thousand more by chance: more of them near
the middle of the scene, where distances are alike, than at its rim. The number expected by chance follows for every
correspondence from the distances of its two points to all others, each side by itself: had the others been matched
at random, two distances of the two histograms would be within the threshold as often as

    E ~ sum over d of f(d) g(d),  f and g the densities of the distances on the two sides,

in all as many times as the correspondences do agree. Those with the highest excess in standard deviations are chosen;
then once more, counted against the chosen ones alone, among which inliers are many times as frequent.

The densities are smoothed over a sixth of the scene, and not for their noise alone. The two points of an inlier are
one place, which has the same distances to the scene on both sides in all detail, so f and g rise and fall together: a
sum in that detail is higher for inliers, and would take off much of what tells them from others. Smoothed, it takes off
what the rough place in the scene explains.

A few hundred points stand for all in the histograms. Those of a random draw would make the expectation as noisy as the
degrees themselves, at which the excess that 20 inliers bring is lost; so they are taken at equal steps along a Z curve,
where each stands for as many around it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.geometry.morton import morton_order
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.native import KERNEL_TYPES, call, native
from torchreg.solvers.compatibility.graph import TILE_ELEMENTS, agreeing, squares

_ANCHORS = 512  # points that stand for all in the histograms
_BINS = 64  # over the largest distance
_SMOOTHED = 11  # neighboring bins: a sixth of them, and more than five thresholds in any case
_COLUMNS = 4096


def choose_nodes(source: Tensor, target: Tensor, threshold: float, count: int) -> Tensor:
    """Places (N,) int64, ascending, of ``count`` of the correspondences (3, M) twice, meters.

    Made of elementwise operations and of whole numbers, so that neither threads nor tiles change the choice.
    """
    matches = source.shape[1]
    if matches <= count:
        return torch.arange(matches, device=source.device)
    points = (source, target)
    excess = _excess(points, points, degrees(source, target, threshold), threshold)
    chosen = _highest(excess, count)
    others = (source[:, chosen].contiguous(), target[:, chosen].contiguous())
    return _highest(_excess(points, others, degrees_among(points, others, threshold), threshold), count)


def degrees(source: Tensor, target: Tensor, threshold: float) -> Tensor:
    """(M,), whole numbers: how many correspondences agree with each, itself counted. Each two are compared once."""
    matches = source.shape[1]
    if native(source, target) and source.dtype in KERNEL_TYPES:
        return _degrees_compiled(source, target, threshold)
    degree, spare = torch.zeros_like(source[0]), source.new_empty(3, TILE_ELEMENTS)
    for rows in row_chunks(matches, _COLUMNS, TILE_ELEMENTS):
        p, q = source[:, rows], target[:, rows]
        degree[rows] += agreeing(p, q, (p, q), threshold, spare).sum(dim=1)
        for begin in range(rows.stop, matches, _COLUMNS):
            columns = slice(begin, min(begin + _COLUMNS, matches))
            agree = agreeing(p, q, (source[:, columns], target[:, columns]), threshold, spare)
            degree[rows] += agree.sum(dim=1)
            degree[columns] += agree.sum(dim=0)
    return degree


def _degrees_compiled(source: Tensor, target: Tensor, threshold: float) -> Tensor:
    """As ``degrees``."""
    degree = torch.empty_like(source[0])
    kernel, per_square = f"degrees_{KERNEL_TYPES[source.dtype]}", 1 / (threshold * threshold)
    call(kernel, source.contiguous(), target.contiguous(), len(degree), per_square, degree)
    return degree


def degrees_among(points: tuple[Tensor, Tensor], others: tuple[Tensor, Tensor], threshold: float) -> Tensor:
    """(M,), whole numbers: how many of ``others``, (3, N) twice, agree with each of ``points``, (3, M) twice."""
    if native(*points, *others) and points[0].dtype in KERNEL_TYPES:
        return _degrees_among_compiled(points, others, threshold)
    degree, spare = torch.zeros_like(points[0][0]), points[0].new_empty(3, TILE_ELEMENTS)
    for rows in row_chunks(len(degree), _COLUMNS, TILE_ELEMENTS):
        for columns in row_chunks(others[0].shape[1], 1, _COLUMNS):
            part = (others[0][:, columns], others[1][:, columns])
            degree[rows] += agreeing(points[0][:, rows], points[1][:, rows], part, threshold, spare).sum(dim=1)
    return degree


def _degrees_among_compiled(points: tuple[Tensor, Tensor], others: tuple[Tensor, Tensor], threshold: float) -> Tensor:
    """As ``degrees_among``."""
    p, q, r, s = (side.contiguous() for side in (*points, *others))
    degree = torch.empty_like(p[0])
    kernel, per_square = f"degrees_among_{KERNEL_TYPES[p.dtype]}", 1 / (threshold * threshold)
    call(kernel, p, q, p.shape[1], r, s, r.shape[1], per_square, degree)
    return degree


def _excess(points: tuple[Tensor, Tensor], others: tuple[Tensor, Tensor], degree: Tensor, threshold: float) -> Tensor:
    """(M,) float64: how far the degrees exceed those expected by chance, in standard deviations."""
    width = max(threshold / 2, max(map(_reach, points)) / (_BINS - 1))
    chance = _chance(points, [_anchors(side) for side in others], width)
    expected = chance * (degree.double().sum() / chance.sum().clamp(min=1))
    return (degree - expected) / (expected + 1).sqrt()


def _chance(points: tuple[Tensor, Tensor], anchors: Sequence[Tensor], width: float) -> Tensor:
    """(M,) float64, whole numbers: how alike the lengths from points (3, M) to anchors (3, A) are on the two sides."""
    count = points[0].shape[1]
    if native(*points, *anchors) and points[0].dtype in KERNEL_TYPES:
        return _chance_compiled(points, anchors, width)
    parts = [
        _alike(*(_histogram(side[:, rows], among, width) for side, among in zip(points, anchors, strict=True)))
        for rows in row_chunks(count, _ANCHORS, TILE_ELEMENTS)
    ]
    return torch.cat(parts)


def _chance_compiled(points: tuple[Tensor, Tensor], anchors: Sequence[Tensor], width: float) -> Tensor:
    """As ``_chance``."""
    p, q, a, b = (side.contiguous() for side in (*points, *anchors))
    alike = torch.empty(p.shape[1], dtype=torch.float64)
    by = (1 / (width * width), _BINS, _SMOOTHED, alike)
    call(f"chance_{KERNEL_TYPES[p.dtype]}", p, q, p.shape[1], a, a.shape[1], b, b.shape[1], *by)
    return alike


def _highest(excess: Tensor, count: int) -> Tensor:
    """The places of the highest, ties to the earlier, ascending."""
    return excess.sort(descending=True, stable=True).indices[:count].sort().values


def _alike(one: Tensor, other: Tensor) -> Tensor:
    """(R,) the sum of f g, not normalized, of the lengths in two histograms (R, bins). A whole number, so exact."""
    return (_moving_sum(one) * _moving_sum(other)).sum(dim=1)


def _moving_sum(counts: Tensor) -> Tensor:
    """(R, bins + _SMOOTHED - 1) sums over ``_SMOOTHED`` neighboring bins of counts (R, bins), the ends included."""
    below = torch.nn.functional.pad(counts, (_SMOOTHED, _SMOOTHED - 1)).cumsum(dim=1)
    return below[:, _SMOOTHED:] - below[:, :-_SMOOTHED]


def _anchors(points: Tensor) -> Tensor:
    """Of points (3, M) at most ``_ANCHORS``, in number as the points are everywhere."""
    count = points.shape[1]
    step = -(-count // _ANCHORS)
    order = morton_order(points.t(), torch.tensor([0, count]))
    return points[:, order[step // 2 :: step]]


def _histogram(points: Tensor, anchors: Tensor, width: float) -> Tensor:
    """Counts (R, bins) float64 of the lengths from points (3, R) to anchors (3, A)."""
    out, between = points.new_empty(2, points.shape[1], anchors.shape[1])
    square = squares(points, anchors, out, between).mul_(1 / (width * width))
    bins = square.sqrt().floor_().clamp_(max=_BINS - 1)
    # by whole numbers, and so whatever the last bit of the root
    bins += ((bins + 1).square_() <= square).to(bins)
    bins -= (bins * bins > square).to(bins)
    bins = bins.clamp_(max=_BINS - 1).long()
    bins += torch.arange(len(bins), device=bins.device)[:, None] * _BINS
    return torch.bincount(bins.flatten(), minlength=len(bins) * _BINS).reshape(-1, _BINS).double()


def _reach(points: Tensor) -> float:
    """No length among points (3, M) is greater, in meters."""
    x, y, z = (points.amax(dim=1) - points.amin(dim=1)).tolist()
    return math.sqrt(x * x + y * y + z * z)
