"""The derivative of ``pair_positions`` by hand: one pass of elementwise operations, for the way back through a piece.

With the names of ``pairs`` (u, g, n, v = u x n, L = |v|, a = n.u, c = g.u, t = n.g, N = n.n, the sign s of the
exchange), the numbers are

    S = (N c - a t) / L,   C = N + s t,   f1 = atan2(S, C),   f2 = v.g / L,   f3 = s a

and with e = dS / L, h = df2 / L, where dX is the gradient that arrives at X,

    dc = N e,   da = s df3 - t e,   dt = s dC - a e,   dN = dC + c e,   dL = -(S dS + f2 df2) / L
    dv = h g + (dL / L) v
    dg = h v + dc u + dt n
    dn = 2 dN n + dt g + da u + dv x u
    du = dc g + da n + n x dv,   dd = (du - u (u.du)) / |d|

``autograd`` gives the same numbers, but keeps and walks every step; this is one function that compilers can fuse.
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchreg.descriptors.soft.pairs import Pair

Vector = tuple[Tensor, Tensor, Tensor]


class PairGradient(NamedTuple):
    """Gradients (R, K) with respect to the two points of every pair: what a neighbor gets, and its query.

    Attributes:
        line: of the neighbor's position; the query's is its opposite.
        query_normal: of the query's normal.
        neighbor_normal: of the neighbor's.
    """

    line: Vector
    query_normal: Vector
    neighbor_normal: Vector


def pair_gradient(pair: Pair, of_f1: Tensor, of_f2: Tensor, of_f3: Tensor) -> PairGradient:
    """From gradients (R, K) of the angles f1, f2 and f3 to those of the points; zero where an angle is open."""
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


def _cross(a: tuple[Tensor, ...], b: tuple[Tensor, ...]) -> list[Tensor]:
    return [
        (a[1] * b[2]).sub_(a[2] * b[1]),
        (a[2] * b[0]).sub_(a[0] * b[2]),
        (a[0] * b[1]).sub_(a[1] * b[0]),
    ]


def _vector(values: tuple[Tensor, ...]) -> Vector:
    return values[0], values[1], values[2]
