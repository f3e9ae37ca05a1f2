"""Tensors of rows as arguments of kernels, without copies of views such as ``index[:, :30]``."""

from __future__ import annotations

from torch import Tensor


def rows(values: Tensor) -> tuple[Tensor, int]:
    """The memory of a tensor (P, K) from its first entry to its last, and how many entries apart its rows begin.

    Copies only where the entries of a row do not follow one another.
    """
    if values.numel() == 0:
        return values.detach().reshape(-1), 0
    count, width = values.shape
    stride = values.stride(0)
    if (width > 1 and values.stride(1) != 1) or (count > 1 and stride < width):
        values, stride = values.contiguous(), width
    return values.detach().as_strided(((count - 1) * stride + width,), (1,)), stride
