"""Exact nearest neighbors in feature space by compiled kernels, from lower bounds in few dimensions.

A row x, taken from the center, has a part V V^T x in the directions V along which the table varies most, and a rest r:

    |a - b|^2 >= |V^T a - V^T b|^2 + (|r_a| - |r_b|)^2

So the shadow (V^T x, |r|) of a row in some 16 dimensions bounds distances from below, at a fraction of the work of all
dimensions. What of the table may be nearer than the nearest so far is then compared in full, in float64: a few rows of
thousands, where the directions are few that features vary in. The bounds are products in float32, with the error that
``torchreg.matching.product`` derives; so they rule out nothing that is near. Results are those of ``feature_nearest``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.matching.nearest import feature_nearest, settle_ties
from torchreg.native import KERNEL_TYPES, call, native

_SHARE = 0.9  # of the table's variance in the directions kept: fastest between 0.85 and 0.95 on scans
_SAMPLE = 1024  # rows that tell the directions
_MANY = 64  # rows compared in full, after which a query may be handed on as one in a crowd
_STEP = 8  # directions that the kernel takes at once


class Shadows(NamedTuple):
    """Rows and their shadows."""

    rows: Tensor  # (N, D) float32 or float64
    shadow: Tensor  # (N, K) float32, in units of the scale
    norm: Tensor  # (N,) float64, distance from the center, in units of the scale

    def at(self, index: Tensor) -> Shadows:
        """Some of the rows."""
        return Shadows(*(column.index_select(0, index) for column in self))


class Shadowed(NamedTuple):
    """Both sides of a search, in the same directions."""

    source: Shadows
    target: Shadows
    scale: float  # a power of two above every distance from the center
    unit: float  # error of a bound per square of the sum of both rows' norms
    tiny: float  # error of a bound where numbers underflow


def compiled(source: Tensor, target: Tensor) -> bool:
    """Whether the kernels take these features."""
    return source.dtype in KERNEL_TYPES and native(source, target)


def nearest_rows(query: Tensor, table: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Rows (N, K) int64 and distances (N, K) float64 of ``feature_nearest``, by whichever way is at hand."""
    if not compiled(query, table):
        found = feature_nearest(query, table, count)
        return found.row, found.distance
    both = shadowed(query, table)
    return shadows_nearest(both.source, both.target, both, count)


def shadowed(source: Tensor, target: Tensor) -> Shadowed:
    """The shadows of rows (N, D) and (M, D), N, M >= 1, finite; in the directions of the target."""
    source, target = source.detach().contiguous(), target.detach().contiguous()
    sample = target[:: -(-len(target) // _SAMPLE)].double()
    center = sample.mean(dim=0)
    basis = _directions(sample - center)
    sides = [_projected(rows, center, basis) for rows in (source, target)]
    largest = max(float(norm.amax()) for _, norm in sides)
    scale = 2.0 ** math.frexp(largest)[1] if math.isfinite(largest) else 1.0
    one, other = (
        Shadows(rows, (shadow / scale).float(), norm / scale)
        for rows, (shadow, norm) in zip((source, target), sides, strict=True)
    )
    width = one.shadow.shape[1]
    single, double = torch.finfo(torch.float32), torch.finfo(torch.float64)
    # of the product and its factors, and of the rest: the root of a difference of squares that may cancel
    unit = (width + 10) * (single.eps + double.eps) / 2 + 4 * math.sqrt(16 * source.shape[1] * double.eps)
    return Shadowed(one, other, scale, unit, (width + 2) * single.tiny)


def shadows_nearest(
    query: Shadows, table: Shadows, both: Shadowed, count: int, bound: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """The ``count`` nearest rows of ``table`` for every query: rows (N, K) int64 and distances (N, K) float64.

    K is ``count``, or the number of rows of the table where that is less; ascending by (distance, row).

    Args:
        query: one of the sides, or a part of it.
        table: the same of the other side.
        both: where they come from.
        count: at least 1.
        bound: (N,) float64, at least ``count`` rows are no farther; ``None`` where nothing is known.
    """
    count = min(count, len(table.rows))
    row = torch.zeros(len(query.rows), count, dtype=torch.int64)
    square = torch.full((len(query.rows), count), float("inf"), dtype=torch.float64)
    call(
        f"feature_nearest_{KERNEL_TYPES[query.rows.dtype]}",
        *(*query, len(query.rows)),
        *(*table, len(table.rows)),
        *(query.rows.shape[1], query.shadow.shape[1]),
        *(bound, count, _MANY + 4 * count),
        *(both.scale, both.unit, both.tiny),
        *(row, square),
    )
    distance = square.sqrt()
    tied = (row[:, 0] < 0).nonzero()[:, 0]
    if len(tied) > 0:
        row[tied], distance[tied] = settle_ties(query.rows[tied], table.rows, count, distance[tied, 0])
    return row, distance


def _directions(centered: Tensor) -> Tensor:
    """Directions (D, K) along which rows (N, D) float64 vary most, zeros where K has no more of them."""
    largest = centered.abs().amax()
    centered = centered / torch.where(largest > 0, largest, 1)
    # not finite: no directions are found, and what comes back is as good as what was given
    variance, direction = torch.linalg.eigh(torch.nan_to_num(centered.t() @ centered))
    share = variance.flip(0).cumsum(0) / variance.sum()
    kept = min(len(variance), -(-(int((share < _SHARE).sum()) + 1) // _STEP) * _STEP)
    return torch.nn.functional.pad(direction.flip(1)[:, :kept], (0, -kept % _STEP)).contiguous()


def _projected(rows: Tensor, center: Tensor, basis: Tensor) -> tuple[Tensor, Tensor]:
    """Shadows (N, K + 1) and distances from the center (N,), float64."""
    shadow = center.new_empty(len(rows), basis.shape[1] + 1)
    norm = center.new_empty(len(rows))
    call(f"feature_shadows_{KERNEL_TYPES[rows.dtype]}", rows, center, basis, *rows.shape, basis.shape[1], shadow, norm)
    return shadow, norm
