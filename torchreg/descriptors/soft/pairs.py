r"""The pair feature of ``descriptors.pair_features`` with gradients.

With u = d / |d|, g = n2 - n1 and n the normal that takes the first place, the arrangement is that of
``compact_pair_features``:

    across = |u x n|,   f1 = atan2(((g.u)(n.n) - (n.u)(n.g)) / across, n1.n2),   f2 = (u x n).g / across,   f3 = n.u

the last one with its sign turned where the points are exchanged.

Continuity. The points exchange their roles where |n1.u| = |n2.u|. There f2 is continuous. f1 and f3 are continuous
where n1.u = -n2.u and turn their sign where n1.u = n2.u, so their histograms jump there, as the hard ones do: no
continuous choice of one of two directions for an unordered pair exists. The roles are held fixed in the derivative.
Where the points coincide or u is parallel to n, the angles are undefined; the three numbers are zero there, as in the
hard kernel, and have no gradient. f1 has none where n2 is parallel to u x n either (f2 = 1 or -1, the direction of f1
has length zero).

The derivative by hand (``pair_gradient``) is one pass of elementwise operations that compilers can fuse; ``autograd``
gives the same numbers, but keeps and walks every step. With v = u x n, L = |v|, a = n.u, c = g.u, t = n.g, N = n.n and
the sign s of the exchange,

    S = (N c - a t) / L,   C = N + s t,   f1 = atan2(S, C),   f2 = v.g / L,   f3 = s a

and with e = dS / L, h = df2 / L, where dX is the gradient that arrives at X,

    dc = N e,   da = s df3 - t e,   dt = s dC - a e,   dN = dC + c e,   dL = -(S dS + f2 df2) / L
    dv = h g + (dL / L) v
    dg = h v + dc u + dt n
    dn = 2 dN n + dt g + da u + dv x u
    du = dc g + da n + n x dv,   dd = (du - u (u.du)) / |d|
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.pair_features import Oriented
from torchreg.descriptors.soft.angle import angle

Vector = tuple[Tensor, Tensor, Tensor]


class ArrangedPair(NamedTuple):
    """What the three angles of pairs (R, K) and their derivatives are made of."""

    u: Vector  # unit vector from query to neighbor
    inverse_length: Tensor  # 1 / |d|, 0 where the points coincide
    g: Vector  # the neighbor's normal less the query's
    n: Vector  # the normal that takes the first place
    v: Vector  # u x n
    across: Tensor  # |u x n|, 1 where it is zero
    square: Tensor  # n.n
    turn: Tensor  # n.g
    along: Tensor  # n.u
    change: Tensor  # g.u
    swap: Tensor  # 1 where the neighbor takes the first place, else 0
    sign: Tensor  # 1 - 2 swap
    sine: Tensor  # the direction of f1, second coordinate
    cosine: Tensor  # first coordinate
    f2: Tensor  # v.g / across
    proper: Tensor  # 1 where the angles are defined, else 0
    decided: Tensor  # 1 where the direction of f1 has a length, too


def arranged_pair(query: Oriented, neighbor: Oriented, *, exchange: bool = True) -> ArrangedPair:
    """Query points (R, 1) and their neighbors (R, K), arranged; by differentiable operations.

    Without ``exchange`` the query has the first place in every pair.
    """
    dx, dy, dz = neighbor.x - query.x, neighbor.y - query.y, neighbor.z - query.z
    distance = _dot(dx, dy, dz, dx, dy, dz)
    apart = distinct(distance).to(distance.dtype)
    inverse = apart / (distance + (1 - apart)).sqrt()
    ux, uy, uz = dx * inverse, dy * inverse, dz * inverse
    swap = _exchanged(query, neighbor).to(ux.dtype) if exchange else torch.zeros_like(ux)  # lerp gives its ends exactly
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
    u, g, n, v = (ux, uy, uz), (gx, gy, gz), (nx, ny, nz), (vx, vy, vz)
    return ArrangedPair(
        u, inverse, g, n, v, across, square, turn, along, change, swap, sign, sine, cosine, f2, proper, decided
    )


def pair_positions(pair: ArrangedPair) -> tuple[Tensor, Tensor, Tensor]:
    """f1, f2 and f3 (R, K) of pairs, scaled to [0, 1] from [-pi, pi], [-1, 1] and [-1, 1].

    Gradients flow to points and normals.
    """
    f1 = angle(pair.sine * pair.decided, pair.cosine * pair.decided + (1 - pair.decided))
    f2 = pair.f2 * (pair.proper * 0.5)
    f3 = pair.along * (pair.sign * pair.proper * 0.5)
    return f1 * (0.5 / math.pi) + 0.5, f2 + 0.5, f3 + 0.5


class PairGradient(NamedTuple):
    """Gradients (R, K) with respect to the two points of every pair, query and neighbor."""

    line: Vector  # of the neighbor's position; the query's is its opposite
    query_normal: Vector  # of the query's normal
    neighbor_normal: Vector  # of the neighbor's


def pair_gradient(pair: ArrangedPair, of_f1: Tensor, of_f2: Tensor, of_f3: Tensor) -> PairGradient:
    """From gradients (R, K) of f1, f2 and f3 to those of the points; zero where an angle is undefined."""
    u, g, n, v = pair.u, pair.g, pair.n, pair.v
    inverse = pair.proper / pair.across
    length = (pair.sine * pair.sine).add_(pair.cosine * pair.cosine).add_(1 - pair.decided)
    turn = of_f1 * pair.decided / length
    of_sine, of_cosine = turn * pair.cosine, (turn * pair.sine).neg_()
    of_f2 = of_f2 * pair.proper
    of_f3 = of_f3 * pair.sign * pair.proper
    e, h = of_sine * inverse, of_f2 * inverse
    dc, da = pair.square * e, of_f3.sub_(pair.turn * e)
    dt, dN = (pair.sign * of_cosine).sub_(pair.along * e), of_cosine.add_(pair.change * e)
    stretch = (pair.sine * of_sine).add_(pair.f2 * of_f2).mul_(inverse).mul_(inverse).neg_()  # dL / L
    dv = tuple((h * g[i]).add_(stretch * v[i]) for i in range(3))
    dg = tuple((h * v[i]).add_(dc * u[i]).add_(dt * n[i]) for i in range(3))
    dN = dN.mul_(2)
    dn = _cross(dv, u)
    for i in range(3):
        dn[i].add_(dN * n[i]).add_(dt * g[i]).add_(da * u[i])
    du = _cross(n, dv)
    for i in range(3):
        du[i].add_(dc * g[i]).add_(da * n[i])
    radial = (u[0] * du[0]).add_(u[1] * du[1]).add_(u[2] * du[2])
    line = tuple(du[i].sub_(u[i] * radial).mul_(pair.inverse_length) for i in range(3))
    second = tuple((dn[i] * pair.swap).add_(dg[i]) for i in range(3))
    first = tuple(dn[i].sub_(second[i]) for i in range(3))  # (1 - swap) dn - dg
    return PairGradient(_vector(line), _vector(first), _vector(second))


def _exchanged(query: Oriented, neighbor: Oriented) -> Tensor:
    """(R, K) whether the neighbor takes the first place, with the roundings of the hard kernels."""
    query, neighbor = Oriented(*(part.detach() for part in query)), Oriented(*(part.detach() for part in neighbor))
    dx, dy, dz = neighbor.x - query.x, neighbor.y - query.y, neighbor.z - query.z
    along = _dot(query.nx, query.ny, query.nz, dx, dy, dz)
    if dx.dtype == torch.float64:  # as pair_features
        length = _dot(dx, dy, dz, dx, dy, dz).sqrt()
        length = torch.where(length == 0, 1, length)
        other = _dot(neighbor.nx, neighbor.ny, neighbor.nz, dx, dy, dz)
        return (along / length).abs() < (other / length).abs()
    gx, gy, gz = neighbor.nx - query.nx, neighbor.ny - query.ny, neighbor.nz - query.nz
    change = _dot(gx, gy, gz, dx, dy, dz)  # as compact_pair_features
    return (along * 2 + change) * change > 0


def distinct(sq_distance: Tensor) -> Tensor:
    """Whether points this far apart (squared) count as two: far below any distance between points."""
    least: float = torch.finfo(sq_distance.dtype).tiny ** 0.75
    return sq_distance.detach() > least


def _dot(ax: Tensor, ay: Tensor, az: Tensor, bx: Tensor, by: Tensor, bz: Tensor) -> Tensor:
    return ax * bx + ay * by + az * bz


def _cross(a: tuple[Tensor, ...], b: tuple[Tensor, ...]) -> list[Tensor]:
    return [
        (a[1] * b[2]).sub_(a[2] * b[1]),
        (a[2] * b[0]).sub_(a[0] * b[2]),
        (a[0] * b[1]).sub_(a[1] * b[0]),
    ]


def _vector(values: tuple[Tensor, ...]) -> Vector:
    return values[0], values[1], values[2]
