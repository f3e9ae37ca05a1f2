"""Lengths whose gradient is finite at zero."""

from __future__ import annotations

import torch
from torch import Tensor


def safe_sqrt(square: Tensor) -> Tensor:
    """Square roots of numbers >= 0; zero with gradient zero where a number is not above 0, and NaN of NaN."""
    none = square <= 0
    return torch.where(none, 0, torch.where(none, 1, square).sqrt())


def safe_length(vectors: Tensor) -> Tensor:
    """Euclidean lengths (...) of vectors (..., D). At a zero vector the gradient is zero, one of the subgradients."""
    return safe_sqrt((vectors * vectors).sum(dim=-1))
