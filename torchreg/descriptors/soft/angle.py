"""The angle of a direction, by operations that round alike in every lane.

``torch.atan2`` computes the end of a range by another routine than the rest, so its last bits depend on how rows are
cut. Here the angle is halved until a short series holds: tan(a / 2) = tan(a) / (1 + sqrt(1 + tan(a)^2)).
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from torchreg.geometry.numerics.derivatives import TensorFunction, transformed

_TERMS = {torch.float32: 6, torch.float64: 12}  # of t - t^3 / 3 + ... for t up to tan(pi / 16)


class _Angle(TensorFunction):
    @staticmethod
    def forward(sine: Tensor, cosine: Tensor) -> Tensor:
        length = (sine * sine).add_(cosine * cosine).sqrt_()
        half = sine / length.add_(cosine.abs())  # tan(a / 2), at most 1
        for _ in range(2):
            half = half.div_((half * half).add_(1).sqrt_().add_(1))
        square = half * half
        terms = _TERMS.get(sine.dtype, 6)
        series = torch.zeros_like(square)
        for n in range(terms - 1, -1, -1):
            series = series.mul_(square).add_((-1) ** n / (2 * n + 1))
        front = series.mul_(half).mul_(8)
        behind = _half_turn(sine).sub_(front)
        return torch.where(cosine < 0, behind, front)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:  # noqa: ANN401
        ctx.save_for_backward(*inputs)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor]:  # noqa: ANN401
        sine, cosine = ctx.saved_tensors
        turn = grads[0] / (sine * sine + cosine * cosine)
        return turn * cosine, -turn * sine


def _half_turn(sine: Tensor) -> Tensor:
    """Half a turn with the sign of ``sine``; in a captured graph without that of zeros, which ONNX does not know."""
    half = torch.full_like(sine, math.pi)
    return torch.where(sine < 0, -half, half) if torch.compiler.is_compiling() else torch.copysign(half, sine)


def angle(sine: Tensor, cosine: Tensor) -> Tensor:
    """The angle in [-pi, pi] of the direction (cosine, sine), not both zero, as ``atan2``, to a few roundings.

    Gradients flow, of any order; directions of length zero have none. Inside ``torch.func`` transforms and forward
    derivatives it is ``atan2`` itself.
    """
    if not torch.compiler.is_compiling() and (transformed(sine) or transformed(cosine)):
        return torch.atan2(sine, cosine)
    return _Angle.call(sine, cosine)
