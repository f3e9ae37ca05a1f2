"""Sums over the last dimension in an order that does not depend on the processor: interleaved, in sixteen lanes.

Entry k of a row is added to lane k mod 16, and the lanes are added one after another, in float64 on the CPU. Zeros
behind the last entry change nothing, so that rows may be cut where they end.
"""

from __future__ import annotations

from torch import Tensor

_LANES = 16  # of the kernels too (interleaved.hpp)


def interleaved_sum(values: Tensor) -> Tensor:
    """Sums (...) of floating-point values (..., K), K > 0, along the last dimension. Gradients flow."""
    lanes = values[..., :_LANES].clone()
    for begin in range(_LANES, values.shape[-1], _LANES):
        part = values[..., begin : begin + _LANES]
        lanes[..., : part.shape[-1]] += part
    return lanes.cumsum(dim=-1)[..., -1]
