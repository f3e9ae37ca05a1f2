"""Square roots that compiled code can repeat: those of ``torch.sqrt`` (MKL) are off by a bit now and then."""

from __future__ import annotations

import torch
from torch import Tensor


def square_root(values: Tensor) -> Tensor:
    """x (1 / sqrt(x)) of values of any shape, each operation rounded; zero where they are not above zero."""
    above = values > 0
    return torch.where(above, values * torch.where(above, values, 1.0).rsqrt(), 0.0)
