"""Of many correspondences, those that agree with more others than by chance.

Among 20,000 correspondences 200 inliers agree with each other, and with a thousand more by chance: more of them near
the middle of the scene, where distances are alike, than at its rim. The number expected by chance follows for every
correspondence from the distances of its two points to all others, each side by itself: had the others been matched
at random, two distances of the two histograms would be within the threshold that often. Those with the highest excess
in standard deviations are chosen; then once more, counted against the chosen ones alone, among which inliers are many
times as frequent.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.solvers.compatibility.graph import TILE_ELEMENTS, agreeing, lengths

_ANCHORS = 1024  # of which the histograms are made
_BINS = 512
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


def degrees_among(points: tuple[Tensor, Tensor], others: tuple[Tensor, Tensor], threshold: float) -> Tensor:
    """(M,), whole numbers: how many of ``others``, (3, N) twice, agree with each of ``points``, (3, M) twice."""
    degree, spare = torch.zeros_like(points[0][0]), points[0].new_empty(3, TILE_ELEMENTS)
    for rows in row_chunks(len(degree), _COLUMNS, TILE_ELEMENTS):
        for columns in row_chunks(others[0].shape[1], 1, _COLUMNS):
            part = (others[0][:, columns], others[1][:, columns])
            degree[rows] += agreeing(points[0][:, rows], points[1][:, rows], part, threshold, spare).sum(dim=1)
    return degree


def _excess(points: tuple[Tensor, Tensor], others: tuple[Tensor, Tensor], degree: Tensor, threshold: float) -> Tensor:
    """(M,) float64: how far the degrees exceed those expected by chance, in standard deviations."""
    total = others[0].shape[1]
    step = -(-total // _ANCHORS)
    width = max(threshold, max(map(_reach, points)) / (_BINS - 1))
    chance = []
    for rows in row_chunks(len(degree), max(_ANCHORS, _BINS), TILE_ELEMENTS):
        one, other = (
            _histogram(side[:, rows], among[:, ::step], width) for side, among in zip(points, others, strict=True)
        )
        chance.append(_chance(one, other, width / threshold))
    expected = total * torch.cat(chance)
    return (degree - expected) / (expected + 1).sqrt()


def _highest(excess: Tensor, count: int) -> Tensor:
    """The places of the highest, ties to the earlier, ascending."""
    return excess.sort(descending=True, stable=True).indices[:count].sort().values


def _chance(one: Tensor, other: Tensor, ratio: float) -> Tensor:
    """(R,) how often a length of one histogram (R, bins) is within the threshold of one of the other.

    Lengths are taken to be even inside a bin, whose width is ``ratio`` >= 1 thresholds. The sums are whole.
    """
    same = (one * other).sum(dim=1)
    beside = (one[:, 1:] * other[:, :-1] + one[:, :-1] * other[:, 1:]).sum(dim=1)
    agreeing = (2 / ratio - 1 / ratio**2) * same + 0.5 / ratio**2 * beside
    return agreeing / (one.sum(dim=1) * other.sum(dim=1))


def _histogram(points: Tensor, anchors: Tensor, width: float) -> Tensor:
    """Counts (R, bins) float64 of the lengths from points (3, R) to anchors (3, A)."""
    out, between = points.new_empty(2, points.shape[1], anchors.shape[1])
    bins = lengths(points, anchors, out, between).div_(width).long().clamp_(0, _BINS - 1)
    bins += torch.arange(len(bins), device=bins.device)[:, None] * _BINS
    return torch.bincount(bins.flatten(), minlength=len(bins) * _BINS).reshape(-1, _BINS).double()


def _reach(points: Tensor) -> float:
    """No length among points (3, M) is greater, in meters."""
    x, y, z = (points.amax(dim=1) - points.amin(dim=1)).tolist()
    return math.sqrt(x * x + y * y + z * z)
