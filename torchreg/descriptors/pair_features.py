r"""The three angles between two oriented points, the pair feature of PFH and FPFH.

For points p1, p2 with unit normals n1, n2 and d = p2 - p1, L = |d| (Rusu et al., ICRA 2009,
doi:10.1109/ROBOT.2009.5152473; the roles as in PCL and Open3D: the point whose normal makes the smaller angle
with the line d takes the first place):

    a1 = n1.d / L,  a2 = n2.d / L;  where |a1| < |a2|: exchange the points, so d := -d, a1 := -a2
    v = d x n1 / |d x n1|,  w = n1 x v
    f1 = atan2(w.n2, n1.n2) in (-pi, pi],   f2 = v.n2 in [-1, 1],   f3 = a1 in [-1, 1]

Where L = 0 or d is parallel to n1, all three are zero.

With A = n1.d, B = n2.d, C = n1.n2 the exchange needs no vectors to change places: d x n1 is the shorter of
the two cross products, v.n2 |d x n1| = det(d, n1, n2) either way, and w.n2 |d x n1| = B - A C or B C - A.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

ANGLE_BINS = 11

# f1 falls on one side of the edge phi between two bins as C / (|S| + |C|) falls on one side of this number,
# where (C, S) points in the direction f1: a monotone stand-in for the angle, made of basic operations.
_EDGES = tuple(
    math.cos(phi) / (abs(math.sin(phi)) + abs(math.cos(phi)))
    for phi in (math.pi * odd / ANGLE_BINS for odd in range(1, ANGLE_BINS, 2))
)


class Oriented(NamedTuple):
    """Coordinates and normals as six separate tensors of one shape: structure of arrays."""

    x: Tensor
    y: Tensor
    z: Tensor
    nx: Tensor
    ny: Tensor
    nz: Tensor


class PairFeatures(NamedTuple):
    """What the three histograms need, each (R, K).

    Attributes:
        cosine: n1.n2, the first coordinate of the direction f1.
        sine: w.n2, the second.
        f2: v.n2 in [-1, 1].
        f3: cosine of the angle between line and first normal, in [-1, 1].
    """

    cosine: Tensor
    sine: Tensor
    f2: Tensor
    f3: Tensor


def pair_features(query: Oriented, neighbor: Oriented) -> PairFeatures:
    """Pair features of query points (R, 1) and their neighbors (R, K).

    Only IEEE basic operations, so that chunking and threads leave the bits alone. Degenerate pairs give
    exact zeros. No gradients are meant to flow here: this is the kernel of the hard histogram.
    """
    dx, dy, dz = neighbor.x - query.x, neighbor.y - query.y, neighbor.z - query.z
    A = query.nx * dx + query.ny * dy + query.nz * dz
    B = neighbor.nx * dx + neighbor.ny * dy + neighbor.nz * dz
    C = query.nx * neighbor.nx + query.ny * neighbor.ny + query.nz * neighbor.nz
    vx, vy, vz = (
        dy * query.nz - dz * query.ny,
        dz * query.nx - dx * query.nz,
        dx * query.ny - dy * query.nx,
    )
    ux, uy, uz = (
        dy * neighbor.nz - dz * neighbor.ny,
        dz * neighbor.nx - dx * neighbor.nz,
        dx * neighbor.ny - dy * neighbor.nx,
    )
    triple = vx * neighbor.nx + vy * neighbor.ny + vz * neighbor.nz
    length = (dx * dx + dy * dy + dz * dz).sqrt()
    across = torch.minimum(vx * vx + vy * vy + vz * vz, ux * ux + uy * uy + uz * uz).sqrt()

    swap = (A.abs() < B.abs()).to(A.dtype)
    stay = 1 - swap
    first = A * stay - B * swap  # n1.d after the exchange
    second = B * stay - A * swap  # n2.d after the exchange
    proper = (across > 0).to(A.dtype)
    across = across + (1 - proper)
    length = length + (length == 0)
    return PairFeatures(
        cosine=C * proper + (1 - proper),
        sine=(second - first * C) / across * proper,
        f2=triple / across * proper,
        f3=first / length * proper,
    )


def angle_bins(cosine: Tensor, sine: Tensor) -> Tensor:
    """Bin 0..10 (int64) of the angle atan2(sine, cosine) in 11 equal bins over (-pi, pi]; (0, 0) is angle 0."""
    ratio = cosine / (sine.abs() + cosine.abs())
    passed = torch.zeros_like(ratio)
    for edge in _EDGES:
        passed += ratio.clone().lt_(edge)
    return torch.copysign(passed, sine).add_(ANGLE_BINS // 2).long()


def unit_bins(value: Tensor) -> Tensor:
    """Bin 0..10 (int64) of a value in [-1, 1] in 11 equal bins; 1 falls into the last."""
    return ((value + 1) * ANGLE_BINS).mul_(0.5).floor_().clamp_(0, ANGLE_BINS - 1).long()
