"""The pair feature of ``pair_features`` for float32: fewer operations, arranged so that rounding decides little.

Between almost parallel normals |a1| and |a2| differ by less than float32 holds, and exchanging the points turns the
sign of f3. But the difference g = n2 - n1 of two close normals is exact, and everything that is small there follows
from it: |n1.d| < |n2.d| where (g.d)(n1.d + n2.d) > 0; and with n the normal that has the first place (d and g as
before the exchange) and Lagrange's identity

    v.n2 |d x n| = (d x n).g,   w.n2 |d x n| = (g.d)(n.n) - (n.d)(n.g),   n1.n2 = n.n + (n.g, or -n.g exchanged)

so no vector but n changes places. Nothing here takes n.n to be 1: normals rounded to float32 are off by 1e-7, which
between exactly opposite normals decides whether f1 is pi or -pi.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.descriptors.pair_features import Oriented, PairFeatures


def compact_pair_features(query: Oriented, neighbor: Oriented) -> PairFeatures:
    """Pair features of query points (R, 1) and their neighbors (R, K).

    Elementwise operations that round the same in every lane, so that chunking and threads leave the bits alone.
    Degenerate pairs give exact zeros. No gradients are meant to flow here: this is the kernel of the hard histogram.
    """
    dx, dy, dz = neighbor.x - query.x, neighbor.y - query.y, neighbor.z - query.z
    gx, gy, gz = neighbor.nx - query.nx, neighbor.ny - query.ny, neighbor.nz - query.nz
    along = _dot(query.nx, query.ny, query.nz, dx, dy, dz)  # n1.d
    change = _dot(gx, gy, gz, dx, dy, dz)  # n2.d - n1.d
    swap = (along + along).add_(change).mul_(change).gt_(0)  # 1 or 0: lerp gives its ends exactly
    nx, ny, nz = (torch.lerp(query[i], neighbor[i], swap) for i in (3, 4, 5))
    along += change * swap  # n.d
    sign = 1 - 2 * swap

    vx, vy, vz = (dy * nz).sub_(dz * ny), (dz * nx).sub_(dx * nz), (dx * ny).sub_(dy * nx)
    across = _dot(vx, vy, vz, vx, vy, vz).sqrt_()
    length = _dot(dx, dy, dz, dx, dy, dz).sqrt_()
    proper = across.clone().gt_(0)
    degenerate = 1 - proper
    across += degenerate
    length += degenerate
    square, turn = _dot(nx, ny, nz, nx, ny, nz), _dot(nx, ny, nz, gx, gy, gz)  # n.n, n.g
    sine = (square * change).sub_(along * turn)
    return PairFeatures(
        cosine=turn.mul_(sign).add_(square).mul_(proper).add_(degenerate),
        sine=sine.div_(across).mul_(proper),
        f2=_dot(vx, vy, vz, gx, gy, gz).div_(across).mul_(proper),
        f3=along.mul_(sign).div_(length).mul_(proper),
    )


def _dot(ax: Tensor, ay: Tensor, az: Tensor, bx: Tensor, by: Tensor, bz: Tensor) -> Tensor:
    return (ax * bx).add_(ay * by).add_(az * bz)
