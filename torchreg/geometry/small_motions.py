"""Rotation vectors: axis times angle in radians, and the rotations they stand for (Rodrigues, 1840)."""

from __future__ import annotations

import torch
from torch import Tensor

_SMALL = 1e-4  # radians: below it, series to the fourth power are exact in float64


def rotation_of(vector: Tensor) -> Tensor:
    """The rotations (..., 3, 3) of rotation vectors (..., 3), radians, float64."""
    angle = torch.linalg.vector_norm(vector, dim=-1)[..., None, None]
    small = angle < _SMALL
    safe = torch.where(small, torch.ones_like(angle), angle)
    square = angle * angle
    first = torch.where(small, 1 - square / 6, torch.sin(safe) / safe)
    second = torch.where(small, 0.5 - square / 24, 2 * (torch.sin(safe / 2) / safe).square())
    K = cross_matrix(vector)
    return torch.eye(3, dtype=vector.dtype, device=vector.device) + first * K + second * (K @ K)


def rotation_vector(rotation: Tensor) -> Tensor:
    """The rotation vectors (..., 3), radians, of rotations (..., 3, 3) float64; lengths are in [0, pi]."""
    R = rotation
    sine = torch.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1) / 2
    length = torch.linalg.vector_norm(sine, dim=-1)
    cosine = (torch.diagonal(R, dim1=-2, dim2=-1).sum(-1) - 1) / 2
    angle = torch.atan2(length, cosine)
    small = length < _SMALL
    factor = torch.where(small, 1 + length.square() / 6, angle / torch.where(small, torch.ones_like(length), length))
    # near half a turn the sine fades: the longest column of (R + R^T) / 2 + 1 points along the axis
    symmetric = (R + R.transpose(-1, -2)) / 2 + torch.eye(3, dtype=R.dtype, device=R.device)
    longest = torch.diagonal(symmetric, dim1=-2, dim2=-1).argmax(-1)[..., None, None].expand(*R.shape[:-1], 1)
    axis = torch.nn.functional.normalize(symmetric.gather(-1, longest)[..., 0], dim=-1)
    axis = torch.where((axis * sine).sum(-1, keepdim=True) < 0, -axis, axis)
    halfway = (cosine < 0) & (length < 1e-3)
    return torch.where(halfway[..., None], axis * angle[..., None], sine * factor[..., None])


def cross_matrix(vector: Tensor) -> Tensor:
    """The matrices (..., 3, 3) that multiply by vectors (..., 3) from the left in the cross product."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return torch.stack(rows, dim=-1).view(*vector.shape, 3)
