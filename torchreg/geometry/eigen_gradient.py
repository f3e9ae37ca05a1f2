"""Gradients of the eigenvector of the least eigenvalue, from eigenvectors that have none.

In the basis of the eigenvectors V of C, the matrix V^T C V is diagonal and the least eigenvector is (1, 0, 0). When C
changes it becomes (1, a1, a2) up to its length, with

    r_j = B_j0 + B_j1 a1 + B_j2 a2 - m a_j = 0,   B = V^T C V,   m = B_00 + B_01 a1 + B_02 a2,

so a step a_j <- a_j - r_j / (l_j - l_0), first-order perturbation theory (Golub and Van Loan, Matrix Computations,
section 7.2), has the derivative of the eigenvector. V and the gaps held fixed, every step gains an order: after two
first and second derivatives are exact. Where a gap is closed the direction within it is open, and gets no gradient.
"""

from __future__ import annotations

import torch
from torch import Tensor

_CLOSED_GAP = 1e-12
"""Relative to the largest eigenvalue: points on a line in float32 spread about 1e-14 across it by their rounding."""


def least_eigenvector(matrix: Tensor, values: Tensor, vectors: Tensor) -> Tensor:
    """The first eigenvector with its first and second derivatives with respect to the matrix.

    Args:
        matrix: C (..., 3, 3) float64, symmetric, with gradient.
        values: (..., 3) its eigenvalues, ascending, without gradient.
        vectors: (..., 3, 3) whose columns are its unit eigenvectors, without gradient.

    Returns:
        (..., 3), equal to ``vectors[..., 0]``: the steps are taken relative to their own value. The sign is that of
        ``vectors``. Gradients are finite for any finite matrix.
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
