"""The pair feature of ``pair_features`` for float32: fewer operations, arranged so that rounding does not decide.

Between almost parallel normals |a1| and |a2| differ by less than float32 holds, and exchanging the points turns the
sign of f3. But |A| < |B| exactly when (B - A)(B + A) > 0, and B - A = (n2 - n1).d keeps its digits, since the
difference of two close normals is exact. With A = n1.d, B = n2.d, C = n1.n2 the exchange needs no vectors to change
places either: d x n1 is the shorter of the two cross products, v.n2 |d x n1| = det(d, n1, n2) both ways, and
w.n2 |d x n1| = B - A C or B C - A.
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
    nx, ny, nz = query[3:]
    mx, my, mz = neighbor[3:]
    A = _dot(nx, ny, nz, dx, dy, dz)
    apart = _dot(mx - nx, my - ny, mz - nz, dx, dy, dz)  # B - A
    B = A + apart
    swap = (A + B).mul_(apart).gt_(0)
    first = torch.lerp(A, -B, swap)  # n1.d after the exchange; the ends of lerp are exact
    second = torch.lerp(B, -A, swap)  # n2.d after it
    C = _dot(nx, ny, nz, mx, my, mz)

    vx, vy, vz = (dy * nz).sub_(dz * ny), (dz * nx).sub_(dx * nz), (dx * ny).sub_(dy * nx)
    ux, uy, uz = (dy * mz).sub_(dz * my), (dz * mx).sub_(dx * mz), (dx * my).sub_(dy * mx)
    across = torch.minimum(_dot(vx, vy, vz, vx, vy, vz), _dot(ux, uy, uz, ux, uy, uz)).sqrt_()
    length = _dot(dx, dy, dz, dx, dy, dz).sqrt_()
    proper = across.clone().gt_(0)
    degenerate = 1 - proper
    across += degenerate
    length += length.clone().eq_(0)
    return PairFeatures(
        cosine=(C * proper).add_(degenerate),
        sine=second.sub_(first * C).div_(across).mul_(proper),
        f2=_dot(vx, vy, vz, mx, my, mz).div_(across).mul_(proper),
        f3=first.div_(length).mul_(proper),
    )


def _dot(ax: Tensor, ay: Tensor, az: Tensor, bx: Tensor, by: Tensor, bz: Tensor) -> Tensor:
    return (ax * bx).add_(ay * by).add_(az * bz)
