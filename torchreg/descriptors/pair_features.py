r"""The three angles between two oriented points, the pair feature of PFH and FPFH.

For points p1, p2 with unit normals n1, n2 and d = p2 - p1, L = |d| (Rusu et al., ICRA 2009,
doi:10.1109/ROBOT.2009.5152473; the roles as in PCL and Open3D: the point whose normal makes the smaller angle
with the line d takes the first place):

    a1 = n1.d / L,  a2 = n2.d / L;  where |a1| < |a2|: exchange the points, so d := -d, a1 := -a2
    v = d x n1 / |d x n1|,  w = n1 x v
    f1 = atan2(w.n2, n1.n2) in (-pi, pi],   f2 = v.n2 in [-1, 1],   f3 = a1 in [-1, 1]

Where L = 0 or d is parallel to n1, all three are zero.

The steps are Open3D's, in its order of operations, so that in float64 rounding decides alike where only rounding
decides.

For float32 ``compact_pair_features`` computes the same numbers by fewer operations, arranged so that rounding decides
little. Between almost parallel normals |a1| and |a2| differ by less than float32 holds, and exchanging the points turns
the sign of f3: one pair decided the other way shows in the histograms of all its neighbors, in up to 5 % of the rows of
a real scan. But the difference g = n2 - n1 of two close normals is exact, and everything that is small there follows
from it: |n1.d| < |n2.d| where (g.d)(n1.d + n2.d) > 0; and with n the normal that has the first place (d and g as before
the exchange) and Lagrange's identity

    v.n2 |d x n| = (d x n).g,   w.n2 |d x n| = (g.d)(n.n) - (n.d)(n.g),   n1.n2 = n.n + (n.g, or -n.g exchanged)

so no vector but n changes places. Nothing here takes n.n to be 1: normals rounded to float32 are off by 1e-7, which
between exactly opposite normals decides whether f1 is pi or -pi.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

ANGLE_BINS = 11


def angle_edges(bins: int) -> tuple[float, ...]:
    """Where an odd number of equal bins over (-pi, pi] end on the side of positive angles, from 0 on.

    f1 falls on one side of the edge phi between two bins as C / (|S| + |C|) falls on one side of such a number, where
    (C, S) points in the direction f1: a monotone stand-in for the angle, made of basic operations.
    """
    inner = (math.pi * odd / bins for odd in range(1, bins, 2))
    return tuple(math.cos(phi) / (abs(math.sin(phi)) + abs(math.cos(phi))) for phi in inner)


ANGLE_EDGES = angle_edges(ANGLE_BINS)


class Oriented(NamedTuple):
    """Coordinates and normals as six separate tensors of one shape: structure of arrays."""

    x: Tensor
    y: Tensor
    z: Tensor
    nx: Tensor
    ny: Tensor
    nz: Tensor


class PairFeatures(NamedTuple):
    """What the three histograms need, each (R, K)."""

    cosine: Tensor  # n1.n2, the first coordinate of the direction f1
    sine: Tensor  # w.n2, the second
    f2: Tensor  # v.n2 in [-1, 1]
    f3: Tensor  # cosine of the angle between line and first normal, in [-1, 1]


def pair_features(query: Oriented, neighbor: Oriented) -> PairFeatures:
    """Pair features of query points (R, 1) and their neighbors (R, K), in the dtype that comes in.

    Only elementwise operations, so that chunking and threads leave the bits alone. Degenerate pairs give exact
    zeros. No gradients: this is the kernel of the hard histogram.
    """
    d = _difference(neighbor[:3], query[:3])
    n_query, n_neighbor = query[3:], neighbor[3:]
    length = _dot(d, d).sqrt_()
    length += length.clone().eq_(0)
    a1, a2 = _dot(n_query, d).div_(length), _dot(n_neighbor, d).div_(length)
    swap = a1.abs().lt_(a2.abs())  # 1 or 0, with which lerp gives one end or the other exactly, and fast
    n1 = _choose(n_query, n_neighbor, swap)
    n2 = _choose(n_neighbor, n_query, swap)

    v = _cross(d, n1)
    across = _dot(v, v).sqrt_()
    proper = across.clone().gt_(0)
    across += 1 - proper
    for column in v:
        column.div_(across)
    w = _cross(n1, v)
    sign = (1 - 2 * swap).mul_(proper)  # d, v and w turn round with the exchange
    return PairFeatures(
        cosine=_dot(n_query, n_neighbor).mul_(proper).add_(1 - proper),
        sine=_dot(w, n2).mul_(sign),
        f2=_dot(v, n2).mul_(sign),
        f3=torch.lerp(a1, a2, swap).mul_(sign),
    )


def compact_pair_features(query: Oriented, neighbor: Oriented, *, exchange: bool = True) -> PairFeatures:
    """Pair features of query points (R, 1) and their neighbors (R, K).

    Without ``exchange`` the query has the first place in every pair.

    Elementwise operations that round the same in every lane, so that chunking and threads leave the bits alone.
    Degenerate pairs give exact zeros. No gradients: this is the kernel of the hard histogram.
    """
    dx, dy, dz = neighbor.x - query.x, neighbor.y - query.y, neighbor.z - query.z
    gx, gy, gz = neighbor.nx - query.nx, neighbor.ny - query.ny, neighbor.nz - query.nz
    along = _dot(query[3:], (dx, dy, dz))  # n1.d
    change = _dot((gx, gy, gz), (dx, dy, dz))  # n2.d - n1.d
    swap = (along + along).add_(change).mul_(change).gt_(0)  # 1 or 0: lerp gives its ends exactly
    swap = swap if exchange else torch.zeros_like(swap)
    nx, ny, nz = (torch.lerp(query[i], neighbor[i], swap) for i in (3, 4, 5))
    along += change * swap  # n.d
    sign = 1 - 2 * swap

    vx, vy, vz = (dy * nz).sub_(dz * ny), (dz * nx).sub_(dx * nz), (dx * ny).sub_(dy * nx)
    per_across = _dot((vx, vy, vz), (vx, vy, vz))
    per_length = _dot((dx, dy, dz), (dx, dy, dz))
    proper = per_across.clone().gt_(0)
    degenerate = 1 - proper
    # reciprocal roots: torch's square root on the CPU is not the nearest number, and they cost no division below
    per_across.add_(degenerate).rsqrt_().mul_(proper)
    per_length.add_(degenerate).rsqrt_().mul_(proper)
    square, turn = _dot((nx, ny, nz), (nx, ny, nz)), _dot((nx, ny, nz), (gx, gy, gz))  # n.n, n.g
    sine = (square * change).sub_(along * turn)
    return PairFeatures(
        cosine=turn.mul_(sign).add_(square).mul_(proper).add_(degenerate),
        sine=sine.mul_(per_across),
        f2=_dot((vx, vy, vz), (gx, gy, gz)).mul_(per_across),
        f3=along.mul_(sign).mul_(per_length),
    )


def angle_bins(cosine: Tensor, sine: Tensor, edges: tuple[float, ...] = ANGLE_EDGES) -> Tensor:
    """Bin (int64) of the angle atan2(sine, cosine) in 11 equal bins over (-pi, pi]; (0, 0) is angle 0.

    Other numbers of bins by other edges (``angle_edges``).
    """
    ratio = cosine / (sine.abs() + cosine.abs())
    passed = torch.zeros_like(ratio)
    for edge in edges:
        passed += ratio.clone().lt_(edge)
    return torch.copysign(passed, sine).add_(len(edges)).long()


def unit_bins(value: Tensor, bins: int = ANGLE_BINS) -> Tensor:
    """Bin (int64) of a value in [-1, 1] in equal bins; 1 falls into the last."""
    return ((value + 1) * bins).mul_(0.5).floor_().clamp_(0, bins - 1).long()


_Vector = tuple[Tensor, ...]


def _difference(a: _Vector, b: _Vector) -> _Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _dot(a: _Vector, b: _Vector) -> Tensor:
    return (a[0] * b[0]).add_(a[1] * b[1]).add_(a[2] * b[2])


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return (
        (a[1] * b[2]).sub_(a[2] * b[1]),
        (a[2] * b[0]).sub_(a[0] * b[2]),
        (a[0] * b[1]).sub_(a[1] * b[0]),
    )


def _choose(stay: _Vector, exchanged: _Vector, swap: Tensor) -> _Vector:
    return tuple(torch.lerp(a, b, swap) for a, b in zip(stay, exchanged, strict=True))
