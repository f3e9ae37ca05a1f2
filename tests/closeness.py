"""Equality up to a stated error."""

from __future__ import annotations

import torch
from torch import Tensor


def close(left: Tensor, right: Tensor, atol: float) -> bool:
    """Whether no element of the one is farther than ``atol`` from that of the other, however large they are."""
    return torch.allclose(left, right, rtol=0, atol=atol)
