"""The quaternion of a rotation, with a sign that is always the same."""

from __future__ import annotations

import torch
from torch import Tensor


def quaternion_wxyz(rotation: Tensor) -> Tensor:
    """The unit quaternion (w, x, y, z) of rotations, with w >= 0.

    Args:
        rotation: (..., 3, 3) of any floating-point dtype.

    Returns:
        (..., 4) in the dtype that came.

    Example:
        >>> quaternion_wxyz(torch.eye(3))
        tensor([1., 0., 0., 0.])
    """
    from kornia.geometry.conversions import rotation_matrix_to_quaternion

    # eps=0: kornia below 0.9 adds it under the root, which costs half the digits of float64.
    found: Tensor = rotation_matrix_to_quaternion(rotation, eps=0.0)
    unit = found / torch.linalg.vector_norm(found, dim=-1, keepdim=True)
    return torch.where(unit[..., :1] < 0, -unit, unit)
