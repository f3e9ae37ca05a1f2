"""The rotations that turn points to their partners best, of many covariances at once, without a call per matrix.

For unit quaternions q the sum that a least-squares rotation maximizes is a quadratic form, q^T N q (Horn, JOSA A 4(4),
1987, doi:10.1364/JOSAA.4.000629): the best rotation is the leading eigenvector of a symmetric matrix N of 4 x 4, which
holds sums and differences of the covariance's entries. Shifted until no eigenvalue is negative and squared k times, a
matrix is (N + c I)^(2^k): all but its leading eigenvector vanishes, and every column points along it. Squares are
elementwise operations over the batch: a matrix has its bits whatever stands beside it.

No gradient is meant to flow here; ``torchreg.kabsch`` has one.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.native import call, native

_ROUNDS, _SQUARINGS = 7, 4  # of squarings, after each of which the trace is one again
"""In all 28: eigenvalues that differ by 1e-7 of the leading one are told apart; nearer ones, of points on a line, leave
a rotation between the two best, which is as good to rounding."""


def best_rotation(covariance: Tensor) -> Tensor:
    """Rotations (3, 3, H) that maximize tr(R C) of covariances C (3, 3, H) float64, sum_m p_m q_m^T.

    Always of determinant one, mirrored points included. Where several are equally good, one of them; of a covariance of
    zeros the identity.
    """
    if native(covariance) and covariance.dtype == torch.float64:
        return _rotation_compiled(covariance)
    matrix = _leading(covariance)  # (4, 4, H)
    most = matrix.diagonal().argmax(dim=1)  # (H,)
    column = matrix.gather(0, most.expand(1, 4, -1))[0]  # (4, H)
    w, x, y, z = column
    twice = 2.0 / _in_order(column * column)
    rows = [
        [1.0 - twice * (y * y + z * z), twice * (x * y - w * z), twice * (x * z + w * y)],
        [twice * (x * y + w * z), 1.0 - twice * (x * x + z * z), twice * (y * z - w * x)],
        [twice * (x * z - w * y), twice * (y * z + w * x), 1.0 - twice * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row) for row in rows])


def _rotation_compiled(covariance: Tensor) -> Tensor:
    """As ``best_rotation``."""
    rotation = torch.empty(covariance.shape, dtype=covariance.dtype)
    call("best_rotations", covariance.contiguous(), covariance.shape[2], rotation)
    return rotation


def best_translation(rotation: Tensor, source_mean: Tensor, target_mean: Tensor) -> Tensor:
    """Translations (3, H) that bring the means (3, H) together after rotations (3, 3, H)."""
    x, y, z = source_mean.unbind(0)
    return target_mean - (rotation[:, 0] * x + rotation[:, 1] * y + rotation[:, 2] * z)


def _leading(covariance: Tensor) -> Tensor:
    """Matrices (4, 4, H) whose columns all point along the leading eigenvectors of N."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (row.unbind(0) for row in covariance.unbind(0))
    shift = _in_order(covariance.abs().flatten(0, 1))  # no eigenvalue of N is greater
    above = [yz - zy, zx - xz, xy - yx, xy + yx, zx + xz, yz + zy]
    diagonal = [part + shift for part in (xx + yy + zz, xx - yy - zz, yy - xx - zz, zz - xx - yy)]
    rows = [
        [diagonal[0], above[0], above[1], above[2]],
        [above[0], diagonal[1], above[3], above[4]],
        [above[1], above[3], diagonal[2], above[5]],
        [above[2], above[4], above[5], diagonal[3]],
    ]
    matrix = torch.stack([torch.stack(row) for row in rows])
    some = shift > 0
    even = torch.eye(4, dtype=matrix.dtype, device=matrix.device)[..., None] * 0.25
    matrix = torch.where(some, matrix / torch.where(some, 4.0 * shift, 1.0), even)
    for _ in range(_ROUNDS):
        for _ in range(_SQUARINGS):
            matrix = _in_order(matrix.transpose(0, 1)[:, :, None] * matrix[:, None])  # N is symmetric
        matrix = matrix / _in_order(matrix.diagonal().t())
    return matrix


def _in_order(terms: Tensor) -> Tensor:
    """Sums (...) of terms (K, ...), one after another."""
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total
