"""One Gauss-Newton step over turn and shift: sum the products of (J, r), solve J^T J x = -J^T r."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.native import call, native
from torchreg.refinement.estimator import Update

CHANNELS = 28  # the upper triangle of the 7 x 7 products of (J, r)
_RANK = 1e-10  # of a pivot to its value without the unknowns before: below it the motion is open


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
            part.add_(rows[i:] * (rows[i] * weight))
        begin += 7 - i
    return out


def solve(sums: Tensor, center: Tensor) -> Update:
    """The update of every pair from its sums (B, 28) of ``products`` and the target's center (B, 3), meters; float64.

    The system is solved about the target's center, where it is well conditioned. The motion is then made as Open3D
    makes it, R = Rz Ry Rx of the three angles about the zero of the target's points, from which the center counts, so
    that iterates agree.
    """
    if native(sums, center):
        return _solve_compiled(sums.contiguous(), center.contiguous())
    return _solve(sums, center)


def _solve_compiled(sums: Tensor, center: Tensor) -> Update:
    """As ``_solve``."""
    rotation, usable = sums.new_empty(len(sums), 3, 3), torch.empty(len(sums), dtype=torch.bool)
    translation = torch.empty_like(center)
    call("gauss_newton", sums, center, len(sums), rotation, translation, usable)
    return Update(rotation, translation, usable)


def _solve(sums: Tensor, center: Tensor) -> Update:
    finite = torch.isfinite(sums).all(dim=1)
    rows = sums.new_zeros(len(sums), 7, 7)
    i, j = torch.triu_indices(7, 7, device=sums.device)
    rows[:, i, j] = rows[:, j, i] = torch.where(finite[:, None], sums, torch.zeros_like(sums))
    diagonal = torch.diagonal(rows, dim1=1, dim2=2)[:, :6]
    positive = diagonal > 0
    scale = torch.where(positive, torch.where(positive, diagonal, 1.0).rsqrt(), torch.zeros_like(diagonal))
    across = torch.cat([scale, torch.ones_like(scale[:, :1])], dim=1)
    solution, determined = _eliminated(scale[:, :, None] * rows[:, :6] * across[:, None, :])
    x = -scale * solution  # (B, 6)
    turn, shift = x[:, :3], x[:, 3:]
    rotation = rotation_zyx(turn)
    carried = apply_rotation(rotation, center) - center - _cross(turn, center)
    return Update(rotation, shift + carried, finite & determined)


def _eliminated(system: Tensor) -> tuple[Tensor, Tensor]:
    """The solutions (B, 6) of symmetric systems (B, 6, 7), right sides last, and where a pivot is not too small (B,).

    The diagonal is one, so that no row needs to change places. A least eigenvalue is at most the least pivot.
    """
    determined = torch.ones_like(system[:, 0, 0], dtype=torch.bool)
    pivots = []
    for k in range(6):
        held = system[:, k, k] > _RANK
        determined = determined & held
        pivots.append(torch.where(held, system[:, k, k], 1.0)[:, None])
        factor = system[:, k + 1 :, k] / pivots[k]  # (B, 5 - k)
        system[:, k + 1 :, k + 1 :] -= factor[:, :, None] * system[:, k, None, k + 1 :]
    right = system[:, :, 6]
    for k in reversed(range(6)):
        right[:, k, None] /= pivots[k]
        right[:, :k] -= system[:, :k, k] * right[:, k, None]
    return torch.where(determined[:, None], right, torch.zeros_like(right)), determined


def _cross(left: Tensor, right: Tensor) -> Tensor:
    """Cross products (B, 3), each operation rounded."""
    (a, b, c), (x, y, z) = left.unbind(1), right.unbind(1)
    return torch.stack([b * z - c * y, c * x - a * z, a * y - b * x], dim=1)


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
