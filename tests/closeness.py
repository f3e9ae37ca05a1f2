"""Equality and rigidity up to a stated error."""

from __future__ import annotations

import torch
from torch import Tensor


def close(left: Tensor, right: Tensor, atol: float) -> bool:
    """Whether no element of the one is farther than ``atol`` from that of the other, however large they are."""
    return torch.allclose(left, right, rtol=0, atol=atol)


def assert_rigid(T: Tensor, atol: float = 1e-9) -> None:
    """Check that matrices (..., 4, 4) hold a rotation and a translation."""
    R = T[..., :3, :3]
    eye = torch.eye(4, dtype=T.dtype)
    assert close(R.transpose(-1, -2) @ R, eye[:3, :3].expand_as(R), atol)
    assert close(torch.linalg.det(R), torch.ones((), dtype=T.dtype), atol)
    assert torch.equal(T[..., 3, :], eye[3].expand_as(T[..., 3, :]))
