r"""The pair feature of ``descriptors.pair_features`` with gradients.

With u = d / |d|, g = n2 - n1 and n the normal that takes the first place, the arrangement is that of ``compact_pairs``:

    across = |u x n|,   f1 = atan2(((g.u)(n.n) - (n.u)(n.g)) / across, n1.n2),   f2 = (u x n).g / across,   f3 = n.u

the last one with its sign turned where the points are exchanged.

Continuity. The points exchange their roles where |n1.u| = |n2.u|. There f2 is continuous. f1 and f3 are continuous
where n1.u = -n2.u and turn their sign where n1.u = n2.u, so their histograms jump there, as the hard ones do: no
continuous choice of one of two directions for an unordered pair exists. The roles are held fixed in the derivative.
Where the points coincide or u is parallel to n, the angles are open; the three numbers are zero there, as in the
hard kernel, and have no gradient. f1 has none where n2 is parallel to u x n either (f2 = 1 or -1, the direction of f1
has length zero).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.pair_features import Oriented
from torchreg.descriptors.soft.angle import angle


class Pair(NamedTuple):
    """Everything about pairs (R, K) that their three angles and the derivatives of these are made of.

    Attributes:
        u: unit vector from query to neighbor.
        inverse_length: 1 / |d|, 0 where the points coincide.
        g: the neighbor's normal less the query's.
        n: the normal that takes the first place.
        v: u x n.
        across: |u x n|, 1 where it is zero.
        square: n.n.
        turn: n.g.
        along: n.u.
        change: g.u.
        swap: 1 where the neighbor takes the first place, else 0.
        sign: 1 - 2 swap.
        sine: the direction of f1, second coordinate.
        cosine: first coordinate.
        f2: v.g / across.
        proper: 1 where the angles are defined, else 0.
        decided: 1 where the direction of f1 has a length, too.
    """

    u: tuple[Tensor, Tensor, Tensor]
    inverse_length: Tensor
    g: tuple[Tensor, Tensor, Tensor]
    n: tuple[Tensor, Tensor, Tensor]
    v: tuple[Tensor, Tensor, Tensor]
    across: Tensor
    square: Tensor
    turn: Tensor
    along: Tensor
    change: Tensor
    swap: Tensor
    sign: Tensor
    sine: Tensor
    cosine: Tensor
    f2: Tensor
    proper: Tensor
    decided: Tensor


def arranged_pair(query: Oriented, neighbor: Oriented) -> Pair:
    """Query points (R, 1) and their neighbors (R, K), arranged; by differentiable operations."""
    dx, dy, dz = neighbor.x - query.x, neighbor.y - query.y, neighbor.z - query.z
    distance = _dot(dx, dy, dz, dx, dy, dz)
    apart = distinct(distance).to(distance.dtype)
    inverse = apart / (distance + (1 - apart)).sqrt()
    ux, uy, uz = dx * inverse, dy * inverse, dz * inverse
    swap = _exchanged(query, neighbor).to(ux.dtype)  # lerp gives its ends exactly
    sign = 1 - 2 * swap
    gx, gy, gz = neighbor.nx - query.nx, neighbor.ny - query.ny, neighbor.nz - query.nz
    change = _dot(gx, gy, gz, ux, uy, uz)
    along = _dot(query.nx, query.ny, query.nz, ux, uy, uz) + change * swap
    nx, ny, nz = (torch.lerp(query[i], neighbor[i], swap) for i in (3, 4, 5))
    vx, vy, vz = uy * nz - uz * ny, uz * nx - ux * nz, ux * ny - uy * nx
    across_square = _dot(vx, vy, vz, vx, vy, vz)
    proper = across_square.detach().gt(torch.finfo(ux.dtype).eps ** 2).to(ux.dtype) * apart
    across = (across_square + (1 - proper)).sqrt()
    square, turn = _dot(nx, ny, nz, nx, ny, nz), _dot(nx, ny, nz, gx, gy, gz)
    sine = (square * change - along * turn) / across
    cosine = square + turn * sign
    length = sine.detach() ** 2 + cosine.detach() ** 2
    decided = length.gt(torch.finfo(ux.dtype).eps ** 2).to(ux.dtype) * proper
    f2 = _dot(vx, vy, vz, gx, gy, gz) / across
    return Pair(
        (ux, uy, uz),
        inverse,
        (gx, gy, gz),
        (nx, ny, nz),
        (vx, vy, vz),
        across,
        square,
        turn,
        along,
        change,
        swap,
        sign,
        sine,
        cosine,
        f2,
        proper,
        decided,
    )


def pair_positions(pair: Pair) -> tuple[Tensor, Tensor, Tensor]:
    """f1, f2 and f3 of pairs, each scaled to [0, 1] of its range.

    Returns:
        Three tensors (R, K): f1 over [-pi, pi], f2 and f3 over [-1, 1]. Gradients flow to all that came in.
    """
    f1 = angle(pair.sine * pair.decided, pair.cosine * pair.decided + (1 - pair.decided))
    f2 = pair.f2 * (pair.proper * 0.5)
    f3 = pair.along * (pair.sign * pair.proper * 0.5)
    return f1 * (0.5 / math.pi) + 0.5, f2 + 0.5, f3 + 0.5


def _exchanged(query: Oriented, neighbor: Oriented) -> Tensor:
    """(R, K) whether the neighbor takes the first place, decided by the hard kernels' own roundings."""
    query, neighbor = Oriented(*(part.detach() for part in query)), Oriented(*(part.detach() for part in neighbor))
    dx, dy, dz = neighbor.x - query.x, neighbor.y - query.y, neighbor.z - query.z
    along = _dot(query.nx, query.ny, query.nz, dx, dy, dz)
    if dx.dtype == torch.float64:  # as pair_features
        length = _dot(dx, dy, dz, dx, dy, dz).sqrt()
        length = torch.where(length == 0, 1, length)
        other = _dot(neighbor.nx, neighbor.ny, neighbor.nz, dx, dy, dz)
        return (along / length).abs() < (other / length).abs()
    gx, gy, gz = neighbor.nx - query.nx, neighbor.ny - query.ny, neighbor.nz - query.nz
    change = _dot(gx, gy, gz, dx, dy, dz)  # as compact_pairs
    return (along * 2 + change) * change > 0


def distinct(sq_distance: Tensor) -> Tensor:
    """Whether points this far apart (squared) count as two: far below any distance between points."""
    least: float = torch.finfo(sq_distance.dtype).tiny ** 0.75
    return sq_distance.detach() > least


def _dot(ax: Tensor, ay: Tensor, az: Tensor, bx: Tensor, by: Tensor, bz: Tensor) -> Tensor:
    return ax * bx + ay * by + az * bz
