"""Loops of three links: where the motion around comes back to the identity, the three confirm each other."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, compose, inverse
from torchreg.geometry.small_motions import rotation_vector
from torchreg.site.graph import SiteGraph
from torchreg.site.tolerance import Tolerance

_ENOUGH = 10  # triangles, for a median
_MEDIAN = 2.37  # of chi-square of 3
_WEDGES = 1 << 18  # pairs of links that meet, looked at at once


class Triangles(NamedTuple):
    """Loops of three links that agree, K of them."""

    links: Tensor  # (K, 3) rows of the graph
    turn: Tensor  # (K,) radians by which the way around misses the identity
    shift: Tensor  # (K,) meters, at the center of the third link


def agreeing_triangles(graph: SiteGraph, tolerance: Tolerance) -> Triangles:
    """All triangles whose loop closes within the tolerance; links must stand in the order of a graph."""
    between = (~graph.known).nonzero()[:, 0]
    first, second = graph.first[between], graph.second[between]
    key = first * (graph.count + 1) + second
    begin = torch.searchsorted(first, torch.arange(graph.count + 1))
    wedges = begin[second + 1] - begin[second] if len(first) else first
    turn_variance, shift_variance = tolerance.variances(graph)
    parts = []
    for rows in _chunks(wedges):
        one, two = _joined(rows, begin[second[rows]], wedges[rows])
        closing = first[one] * (graph.count + 1) + second[two]
        start, end = torch.searchsorted(key, closing), torch.searchsorted(key, closing, right=True)
        which, three = _joined(torch.arange(len(one)), start, end - start)
        a, b, c = between[one[which]], between[two[which]], between[three]
        D = compose(compose(graph.T[a], graph.T[b]), inverse(graph.T[c]))
        turn = torch.linalg.vector_norm(rotation_vector(D[:, :3, :3]), dim=1)
        moved = apply_rotation(D[:, :3, :3], graph.center[c]) + D[:, :3, 3] - graph.center[c]
        shift = torch.linalg.vector_norm(moved, dim=1)
        arm = graph.T[c, :3, 3].square().sum(dim=1)
        turns = turn_variance[a] + turn_variance[b] + turn_variance[c]
        shifts = shift_variance[a] + shift_variance[b] + shift_variance[c] + arm * (turn_variance[a] + turn_variance[b])
        good = tolerance.excess(turn, shift, turns, shifts) <= 1
        parts.append((torch.stack([a, b, c], dim=1)[good], turn[good], shift[good]))
    if not parts:
        return Triangles(torch.zeros(0, 3, dtype=torch.int64), *torch.zeros(2, 0, dtype=torch.float64))
    return Triangles(*(torch.cat(part) for part in zip(*parts, strict=True)))


def support(triangles: Triangles, probability: Tensor) -> Tensor:
    """(L,) how many triangles confirm each link, each counted by the probability (L,) of its other two links."""
    total = torch.zeros_like(probability)
    for own, (one, other) in ((0, (1, 2)), (1, (0, 2)), (2, (0, 1))):
        others = probability[triangles.links[:, one]] * probability[triangles.links[:, other]]
        total.index_add_(0, triangles.links[:, own], others)
    return total


def error_scale(graph: SiteGraph, triangles: Triangles) -> float:
    """The factor, 1 or more, by which squared errors of triangles exceed what covariances promise, in the median.

    By turns alone, which no lever lengthens.
    """
    if len(triangles.turn) < _ENOUGH:
        return 1.0
    promised = graph.covariance.diagonal(dim1=1, dim2=2)[:, :3].mean(dim=1)[triangles.links].sum(dim=1)
    return max(1.0, float((triangles.turn.square() / promised).median()) / _MEDIAN)


def _chunks(wedges: Tensor) -> list[Tensor]:
    """Rows in pieces that together have some ``_WEDGES``."""
    piece = (wedges.cumsum(0) - wedges).div(_WEDGES, rounding_mode="floor")
    return list(torch.arange(len(wedges)).split(torch.bincount(piece).tolist())) if len(wedges) else []


def _joined(rows: Tensor, begin: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor]:
    """Every row with each of the ``sizes`` numbers that follow from ``begin``."""
    repeated = rows.repeat_interleave(sizes)
    offset = (sizes.cumsum(0) - sizes).repeat_interleave(sizes)
    return repeated, begin.repeat_interleave(sizes) + torch.arange(len(repeated)) - offset
