"""One Gauss-Newton step over turn and shift: sum the products of (J, r), solve J^T J x = -J^T r."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.refinement.estimator import Update

CHANNELS = 28  # the upper triangle of the 7 x 7 products of (J, r)
_RANK = 1e-10  # of the least to the largest eigenvalue, unknowns scaled alike: below it the motion is not determined


def products(rows: Tensor, weight: Tensor, onto: Tensor | None = None) -> Tensor:
    """Weighted products of (J, r) (7, k, 256) with itself, the upper triangle row by row: (28, k, 256).

    Added in place to ``onto`` where it is given.
    """
    out = rows.new_empty(CHANNELS, *weight.shape) if onto is None else onto
    begin = 0
    for i in range(7):
        part = out[begin : begin + 7 - i]
        if onto is None:
            torch.mul(rows[i:], rows[i] * weight, out=part)
        else:
            part.addcmul_(rows[i:], rows[i] * weight)
        begin += 7 - i
    return out


def solve(sums: Tensor, center: Tensor) -> Update:
    """The update of every pair from its sums (B, 28) of ``products`` and the target's center (B, 3), meters; float64.

    The system is solved about the target's center, where it is well conditioned. The motion is then made as Open3D
    makes it, R = Rz Ry Rx of the three angles about the zero of the target's points, from which the center counts, so
    that iterates agree.
    """
    finite = torch.isfinite(sums).all(dim=1)
    upper = sums.new_zeros(len(sums), 7, 7)
    i, j = torch.triu_indices(7, 7, device=sums.device)
    upper[:, i, j] = torch.where(finite[:, None], sums, torch.zeros_like(sums))
    normal = upper[:, :6, :6] + upper[:, :6, :6].triu(1).transpose(1, 2)  # (B, 6, 6)
    right = upper[:, :6, 6]
    diagonal = torch.diagonal(normal, dim1=1, dim2=2)
    positive = diagonal > 0
    scale = torch.where(positive, 1 / torch.where(positive, diagonal, 1.0).sqrt(), torch.zeros_like(diagonal))
    values, vectors = torch.linalg.eigh(scale[:, :, None] * normal * scale[:, None, :])
    usable = finite & positive.all(dim=1) & (values[:, 0] > _RANK * values[:, 5])
    along = (vectors * (scale * right)[:, :, None]).sum(dim=1)  # (B, 6)
    along = torch.where(usable[:, None], along / torch.where(usable[:, None], values, 1.0), torch.zeros_like(along))
    x = -scale * (vectors * along[:, None, :]).sum(dim=2)  # (B, 6)
    turn, shift = x[:, :3], x[:, 3:]
    rotation = rotation_zyx(turn)
    carried = (rotation * center[:, None, :]).sum(dim=2) - center - torch.linalg.cross(turn, center)
    return Update(rotation, shift + carried, usable)


def rotation_zyx(angles: Tensor) -> Tensor:
    """Rz(c) Ry(b) Rx(a) (B, 3, 3) of angles (a, b, c) (B, 3), radians; one by one, so that no batch changes a bit."""
    matrices = [_rotation_zyx(*row) for row in angles.tolist()]
    return torch.tensor(matrices, dtype=angles.dtype, device=angles.device).view(-1, 3, 3)


def _rotation_zyx(a: float, b: float, c: float) -> list[list[float]]:
    sa, ca, sb, cb, sc, cc = math.sin(a), math.cos(a), math.sin(b), math.cos(b), math.sin(c), math.cos(c)
    return [
        [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
        [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
        [-sb, cb * sa, cb * ca],
    ]
