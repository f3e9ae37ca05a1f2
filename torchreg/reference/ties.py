"""Pairs whose vote rounding decides: where two right implementations of FPFH may differ.

A vote of a pair goes to another bin when a feature lies on the edge between two bins; when |a1| = |a2|, so that
either point may take the first place and the two ways differ (equal or opposite normals are no tie: rounding is
the same on both sides); or when the line is almost along the first normal, or the second normal along v, so that an
angle is ill-defined. Detected from the definition with vectors and an arc tangent, apart from the kernels that
are compared.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.histograms import neighbor_votes
from torchreg.descriptors.pair_features import ANGLE_BINS
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.types import Clouds, Neighborhoods

KINDS = ("edge of f1", "edge of f2", "edge of f3", "exchange", "line along a normal")


class Rounding(NamedTuple):
    """How far the features may be off in a floating-point type, and when they have lost half of their digits."""

    position: float  # of a feature, in widths of a bin
    direction: float  # of v, in radians, where the line is across the normal; it grows with the inverse of their sine
    parallel: float  # the sine of line and normal below which v has no direction


ROUNDING = {torch.float64: Rounding(1e-12, 1e-15, 1e-7), torch.float32: Rounding(4e-6, 1e-6, 1e-3)}

_COSINE = 1e-12  # rounding of n.d / L in float64, as Open3D computes it
_TINY = 1e-15


class Tie(NamedTuple):
    """One vote that rounding decides.

    Attributes:
        row: the point whose histogram the vote goes to.
        neighbor: the other point of the pair.
        kind: one of ``KINDS``.
    """

    row: int
    neighbor: int
    kind: str


class Ties(NamedTuple):
    """All of a cloud."""

    pairs: list[Tie]  # every one, by row
    touched: Tensor  # (P,) bool, rows of FPFH with a tie in their own histogram or in that of a neighbor


def find_ties(cloud: Clouds, near: Neighborhoods, rounding: Rounding = ROUNDING[torch.float64]) -> Ties:
    """The ties among the pairs that vote.

    Args:
        cloud: points and normals, float64.
        near: their neighborhoods.
        rounding: of the less exact of the two that are compared.

    Raises:
        ValueError: no normals.
    """
    normals = cloud.normals
    if normals is None:
        raise ValueError("cloud: expected normals, got none")
    tied_rows = torch.zeros(len(near), dtype=torch.bool)
    pairs: list[Tie] = []
    for rows in row_chunks(len(near), near.max_neighbors):
        index, counted = near.index[rows], neighbor_votes(near.index, near.valid, rows)
        query = (cloud.points[rows, None], normals[rows, None])
        neighbor = (cloud.points[index], normals[index])
        tied = _tied(query, neighbor, rounding) & counted[..., None]  # (r, K, kinds)
        tied_rows[rows] = tied.any(dim=2).any(dim=1)
        for row, slot, kind in tied.nonzero().tolist():
            pairs.append(Tie(rows.start + row, int(index[row, slot]), KINDS[kind]))
    touched = tied_rows.clone()
    for rows in row_chunks(len(near), near.max_neighbors):
        touched[rows] |= (tied_rows[near.index[rows]] & near.valid[rows]).any(dim=1)
    return Ties(pairs, touched)


class _Positions(NamedTuple):
    """Of the three features on the axis of their 11 bins, (..., 3), and how far rounding moves each, (..., 3)."""

    value: Tensor
    rounding: Tensor
    sine: Tensor


def _tied(query: tuple[Tensor, Tensor], neighbor: tuple[Tensor, Tensor], rounding: Rounding) -> Tensor:
    """(r, K, kinds) bool for points and normals (r, 1, 3) and (r, K, 3)."""
    (p1, n1), (p2, n2) = query, neighbor
    line = p2 - p1
    length = line.norm(dim=-1, keepdim=True)
    line = line / torch.where(length > 0, length, torch.ones_like(length))
    first, second = (n1 * line).sum(dim=-1), (n2 * line).sum(dim=-1)
    forth, back = _positions(n1, n2, line, rounding), _positions(n2, n1, -line, rounding)
    exchange = first.abs() < second.abs()
    chosen = _Positions(*(torch.where(exchange[..., None], b, a) for a, b in zip(forth, back, strict=True)))
    edge = chosen.value.round()
    on_edge = (chosen.value - edge).abs() < chosen.rounding
    on_edge[..., 1:] &= (edge[..., 1:] > 0) & (edge[..., 1:] < ANGLE_BINS)  # beyond the ends there is no other bin
    unlike = torch.minimum((n1 - n2).norm(dim=-1), (n1 + n2).norm(dim=-1))
    even = (first.abs() - second.abs()).abs() < _COSINE + rounding.position * unlike
    even &= unlike > 0
    differ = (_bins(forth.value) != _bins(back.value)).any(dim=-1)
    parallel = (chosen.sine[..., 0] > 0) & (chosen.sine[..., 0] < rounding.parallel)
    proper = (length[..., 0] > 0) & (chosen.sine[..., 0] > 0)  # a degenerate pair votes for the middle bins, exactly
    tied: Tensor = torch.cat([on_edge, (even & differ)[..., None], parallel[..., None]], dim=-1) & proper[..., None]
    return tied


def _positions(n1: Tensor, n2: Tensor, line: Tensor, rounding: Rounding) -> _Positions:
    """Features of oriented points along a unit line, the first in the first place."""
    v = torch.linalg.cross(line, n1.expand_as(line), dim=-1)
    sine = v.norm(dim=-1, keepdim=True)
    v = v / torch.where(sine > 0, sine, torch.ones_like(sine))
    w = torch.linalg.cross(n1.expand_as(v), v, dim=-1)
    x, y = (n1 * n2).sum(dim=-1), (w * n2).sum(dim=-1)
    f2, f3 = (v * n2).sum(dim=-1), (n1 * line).sum(dim=-1)
    f1 = torch.atan2(y, x)
    value = torch.stack([(f1 + math.pi) / math.pi, f2 + 1, f3 + 1], dim=-1) * (ANGLE_BINS / 2)
    of_v = rounding.direction / sine[..., 0].clamp_min(_TINY)
    moved = torch.stack([of_v / torch.hypot(x, y).clamp_min(_TINY), of_v, torch.zeros_like(of_v)], dim=-1)
    return _Positions(value, rounding.position + moved, sine.expand_as(value))


def _bins(positions: Tensor) -> Tensor:
    return positions.floor().clamp(0, ANGLE_BINS - 1)
