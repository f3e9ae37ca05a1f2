"""How lengths between matches compare in the two clouds: the factor that most of them share.

Where k of M matches agree under some motion, mirrored or not, and some factor s, about (k / M)^2 of the lengths between
two matches have

    |q_i - q_j| / |p_i - p_j| = s

up to noise, beside those that have it by chance. The ratios are counted in bins of equal ratio, those by chance from
lengths of the one cloud beside lengths of other matches in the other. The excess of the fullest bins then names s, and
k = M (excess / lengths)^(1/2) before any pose is known.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.native import call, native

_LENGTHS = 1 << 15  # that are compared
_LEAST = 10.0  # thresholds: noise moves the ratio of shorter lengths by more than a few bins
_STEP = 0.01  # of the logarithm: bins of 1 %
_BINS = 139  # on either side of the factor 1: up to a factor of 4
_REPAIRINGS = 2


class LengthRatios(NamedTuple):
    """The factor at which ratios of lengths peak, and what the peak implies."""

    factor: float  # lengths in the target over lengths in the source, to about 1 %; 1 stands for 0.985 to 1.015
    support: float  # matches that agree at this factor, under a motion or a reflection; somewhat too few
    support_at_one: float  # matches that agree at the factor 1, likewise


def length_ratios(source: Tensor, target: Tensor, threshold: float) -> LengthRatios:
    """Compare lengths between matches, source and target (M, 3) float64 in meters, M >= 2; an inlier's threshold.

    An even choice of lengths, elementwise operations and whole numbers: nothing is drawn, and threads change no bit.
    """
    count = len(source)
    binned, compared = _counted(source, target, *_pairs(count, source.device), (_LEAST * threshold) ** 2)
    counts, lengths = binned[0].double(), int(compared[0])
    by_chance = torch.zeros_like(counts)
    for other, number in zip(binned[1:], compared[1:].tolist(), strict=True):
        by_chance += other.double() * (lengths / max(1, number)) / _REPAIRINGS
    excess = (counts - by_chance).unfold(0, 3, 1).sum(dim=1).tolist()  # of three bins: the middle one is named
    one = _BINS - 1  # the bin of the factor 1, among middles
    at_one = max(excess[one - 1 : one + 2])
    fullest = max(range(len(excess)), key=excess.__getitem__)
    factor = 1.0 if abs(fullest - one) <= 1 else math.exp(_STEP * (fullest - one))

    def implied(amount: float) -> float:
        return count * math.sqrt(max(0.0, amount) / max(1, lengths))

    return LengthRatios(factor, implied(excess[fullest]), implied(at_one))


def _pairs(count: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Rows (L,) of the first and second of pairs of matches: all rows beside rows some even steps further on."""
    steps = max(1, min(count - 1, _LENGTHS // count))
    apart = torch.tensor([1 + (k * (count - 1)) // steps for k in range(steps)], device=device)
    stride = max(1, -(-count // _LENGTHS))
    first = torch.arange(0, count, stride, device=device)
    second = (first + apart[:, None]) % count
    return first.expand_as(second).flatten(), second.flatten()


def _counted(source: Tensor, target: Tensor, first: Tensor, second: Tensor, least: float) -> tuple[Tensor, Tensor]:
    """How many ratios fall into every bin (1 + S, bins) int64, and how many are compared (1 + S,) int64.

    Of the lengths between two matches each, and with those of the target moved on to other lengths, S times. Lengths
    whose squares are below ``least`` are left out.
    """
    numbers = [math.exp(2 * _STEP * (bin + 0.5)) for bin in range(-_BINS - 1, _BINS + 1)]
    edges = torch.tensor(numbers, dtype=source.dtype, device=source.device)
    if native(source, target) and source.dtype == target.dtype == torch.float64:
        return _counted_compiled(source, target, first, second, least, edges)
    p, q = (_squared_lengths(side, first, second) for side in (source, target))
    parts = [_counts(p, q.roll(step * len(q) // (_REPAIRINGS + 1)), least, edges) for step in range(1 + _REPAIRINGS)]
    counts, compared = map(torch.stack, zip(*parts, strict=True))
    return counts, compared


def _counted_compiled(
    source: Tensor, target: Tensor, first: Tensor, second: Tensor, least: float, edges: Tensor
) -> tuple[Tensor, Tensor]:
    """As ``_counted``, with the ``edges`` of the bins."""
    counts = torch.zeros(1 + _REPAIRINGS, len(edges) + 1, dtype=torch.int64)
    compared = torch.zeros(1 + _REPAIRINGS, dtype=torch.int64)
    points = (side.detach().contiguous() for side in (source, target))
    ends = (rows.contiguous() for rows in (first, second))
    call("length_ratio_counts", *points, *ends, edges, counts, compared, len(first), len(edges), _REPAIRINGS, least)
    return counts[:, 1:-1], compared


def _squared_lengths(points: Tensor, first: Tensor, second: Tensor) -> Tensor:
    square = torch.zeros(len(first), dtype=points.dtype, device=points.device)
    for axis in points.t().contiguous():
        apart = axis[first] - axis[second]
        square += apart * apart
    return square


def _counts(p: Tensor, q: Tensor, least: float, edges: Tensor) -> tuple[Tensor, Tensor]:
    """How many ratios of squared lengths (L,) fall into every bin, and how many are compared."""
    bins = torch.bucketize(q / p.clamp(min=least), edges)
    long = torch.minimum(p, q) > least
    counts = torch.bincount(torch.where(long, bins, 0), minlength=len(edges) + 1)
    return counts[1:-1], long.sum()
