"""Eigenvectors of many symmetric 3x3 matrices at once, and gradients of the least one.

Cyclic Jacobi rotations (Golub and Van Loan, Matrix Computations, section 8.5), written as elementwise
operations over the batch: no call per matrix, no cosine or cube root, the same bits in any batch. Four sweeps
leave off-diagonal entries below rounding in float64; six are made.

The derivative of the least eigenvector. In the basis of the eigenvectors V of C, the matrix V^T C V is diagonal and
the least eigenvector is (1, 0, 0). When C changes it becomes (1, a1, a2) up to its length, with

    r_j = B_j0 + B_j1 a1 + B_j2 a2 - m a_j = 0,   B = V^T C V,   m = B_00 + B_01 a1 + B_02 a2,

so a step a_j <- a_j - r_j / (l_j - l_0), first-order perturbation theory (Golub and Van Loan, section 7.2), has the
derivative of the eigenvector. With V and the gaps held fixed, every step gains an order: after two, first and second
derivatives are exact. Where a gap is zero the direction within its plane is arbitrary and gets no gradient.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.native import KERNEL_TYPES, call, native

_SWEEPS = 6
_PAIRS = ((0, 1), (0, 2), (1, 2))

_CLOSED_GAP = 1e-12
"""Relative to the largest eigenvalue: points on a line in float32 spread about 1e-14 across it by their rounding."""


def symmetric_eigen(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Ascending eigenvalues (..., 3), and unit eigenvectors as columns (..., 3, 3), of symmetric matrices (..., 3, 3).

    Only the upper triangle is read, of any floating point; signs are arbitrary. Zero and non-finite matrices give the
    identity or NaN, never an error. No gradients flow; ``least_eigenvector`` adds them.
    """
    expect(matrix.shape[-2:] == (3, 3), "matrix", "(..., 3, 3)", matrix)
    matrix = matrix.detach()
    if native(matrix) and matrix.dtype in KERNEL_TYPES:
        return _eigen_compiled(matrix)
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


def least_eigenvector(matrix: Tensor, values: Tensor, vectors: Tensor) -> Tensor:
    """The first eigenvector (..., 3) with its first and second derivatives with respect to the matrix.

    From a symmetric float64 matrix C (..., 3, 3) with gradient and, without one, its ascending eigenvalues (..., 3) and
    unit eigenvectors (columns of (..., 3, 3)). Equal to ``vectors[..., 0]``, sign included: the steps are taken
    relative to their own value. Gradients are finite for any finite matrix.
    """
    gap = values[..., 1:] - values[..., :1]  # (..., 2)
    least = (_CLOSED_GAP * values[..., 2:].abs()).clamp(min=1e-290)
    clear = gap > least
    per_gap = torch.where(clear, 1 / torch.where(clear, gap, 1), 0)
    B = vectors.transpose(-1, -2) @ matrix @ vectors
    lower, across = B[..., 1:, 0], B[..., 1:, 1:]  # (..., 2), (..., 2, 2)
    a = torch.zeros_like(gap)
    for _ in range(2):
        value = B[..., :1, 0] + (lower * a).sum(dim=-1, keepdim=True)
        step = (lower + (across @ a[..., None])[..., 0] - value * a) * per_gap
        a = a - (step - step.detach())
    vector = vectors[..., 0] + (vectors[..., 1:] @ a[..., None])[..., 0]
    return vector / (1 + (a * a).sum(dim=-1, keepdim=True)).sqrt()


def _eigen_compiled(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """As ``symmetric_eigen``."""
    matrix = matrix.contiguous()
    values, vectors = matrix.new_empty(matrix.shape[:-1]), torch.empty_like(matrix)
    call(f"symmetric_eigen_{KERNEL_TYPES[matrix.dtype]}", matrix, matrix.numel() // 9, values, vectors)
    return values, vectors


def _rotate(a: dict[tuple[int, int], Tensor], v: list[list[Tensor]], p: int, q: int) -> None:
    """Zero the entry (p, q) by one rotation, in place in the two containers."""
    app, aqq, apq = a[p, p], a[q, q], a[p, q]
    zero = apq == 0
    theta = (aqq - app) / torch.where(zero, torch.ones_like(apq), apq + apq)
    # theta^2 overflows to infinity when apq is tiny: then t = 0, as it should be
    # 1 / (|theta| + sqrt(theta^2 + 1)), by reciprocal roots: torch's square root on the CPU is not the nearest number
    theta = theta.clamp(-torch.finfo(theta.dtype).max, torch.finfo(theta.dtype).max)
    per_root = (theta * theta + 1).rsqrt()
    t = torch.copysign(per_root / (theta.abs() * per_root + 1), theta)
    t = torch.where(zero, torch.zeros_like(t), t)
    c = (t * t + 1).rsqrt()
    s = t * c
    a[p, p], a[q, q], a[p, q] = app - t * apq, aqq + t * apq, torch.zeros_like(apq)
    r = 3 - p - q
    rp, rq = (min(r, p), max(r, p)), (min(r, q), max(r, q))
    a[rp], a[rq] = c * a[rp] - s * a[rq], s * a[rp] + c * a[rq]
    for row in v:
        row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
