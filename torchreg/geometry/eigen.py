"""Eigenvectors of many symmetric 3x3 matrices at once.

Cyclic Jacobi rotations (Golub and Van Loan, Matrix Computations, section 8.5), written as elementwise
operations over the batch: no call per matrix, no cosine or cube root, the same bits in any batch. Four sweeps
leave off-diagonal entries below rounding in float64; six are made.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect

_SWEEPS = 6
_PAIRS = ((0, 1), (0, 2), (1, 2))


def symmetric_eigen(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues and eigenvectors of symmetric matrices.

    Args:
        matrix: (..., 3, 3) floating point, symmetric; only the upper triangle is read.

    Returns:
        values (..., 3) ascending, and vectors (..., 3, 3) whose columns are unit eigenvectors in that order
        (sign left open). Zero and non-finite matrices give the identity or NaN, never an error. No gradients
        flow: the iteration is not meant to be differentiated.
    """
    expect(matrix.shape[-2:] == (3, 3), "matrix", "(..., 3, 3)", matrix)
    matrix = matrix.detach()
    a = {(i, j): matrix[..., i, j] for i in range(3) for j in range(i, 3)}
    one, zero = torch.ones_like(a[0, 0]), torch.zeros_like(a[0, 0])
    v = [[one if i == j else zero for j in range(3)] for i in range(3)]
    for _ in range(_SWEEPS):
        for p, q in _PAIRS:
            _rotate(a, v, p, q)
    values = torch.stack([a[0, 0], a[1, 1], a[2, 2]], dim=-1)
    vectors = torch.stack([torch.stack(row, dim=-1) for row in v], dim=-2)  # (..., 3, 3), columns
    values, order = values.sort(dim=-1, stable=True)
    return values, vectors.gather(-1, order[..., None, :].expand_as(vectors))


def _rotate(a: dict[tuple[int, int], Tensor], v: list[list[Tensor]], p: int, q: int) -> None:
    """Zero the entry (p, q) by one rotation, in place in the two containers."""
    app, aqq, apq = a[p, p], a[q, q], a[p, q]
    zero = apq == 0
    theta = (aqq - app) / torch.where(zero, torch.ones_like(apq), apq + apq)
    # theta overflows to infinity when apq is tiny: then t = 0, as it should be
    t = torch.copysign(1 / (theta.abs() + (theta * theta + 1).sqrt()), theta)
    t = torch.where(zero, torch.zeros_like(t), t)
    c = 1 / (t * t + 1).sqrt()
    s = t * c
    a[p, p], a[q, q], a[p, q] = app - t * apq, aqq + t * apq, torch.zeros_like(apq)
    r = 3 - p - q
    rp, rq = (min(r, p), max(r, p)), (min(r, q), max(r, q))
    a[rp], a[rq] = c * a[rp] - s * a[rq], s * a[rp] + c * a[rq]
    for row in v:
        row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
