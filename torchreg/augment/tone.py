"""Functions on sRGB colors (P, 3) in [0, 1]: linear light and back, gamma, hue. Gradients are finite everywhere."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.descriptors.color import hsv

_KNEE, _LINEAR_KNEE, _SLOPE, _OFFSET, _POWER = 0.04045, 0.0031308, 12.92, 0.055, 2.4  # IEC 61966-2-1
_DARKEST = 1 / 512  # below it a power would be too steep, and a straight line takes its place


def to_linear(colors: Tensor) -> Tensor:
    """Linear light of sRGB colors (IEC 61966-2-1). Gradients flow."""
    curve = ((colors.clamp_min(_KNEE) + _OFFSET) / (1 + _OFFSET)) ** _POWER
    return torch.where(colors > _KNEE, curve, colors / _SLOPE)


def from_linear(light: Tensor) -> Tensor:
    """sRGB colors of linear light; what is brighter than white becomes larger than 1. Gradients flow."""
    curve = (1 + _OFFSET) * light.clamp_min(_LINEAR_KNEE) ** (1 / _POWER) - _OFFSET
    return torch.where(light > _LINEAR_KNEE, curve, light * _SLOPE)


def apply_gamma(colors: Tensor, gamma: float) -> Tensor:
    """Colors to the power of ``gamma``; straight below 1/512. Black and white stay. Gradients flow."""
    curve = colors.clamp_min(_DARKEST) ** gamma
    return torch.where(colors > _DARKEST, curve, colors * _DARKEST ** (gamma - 1))


def shift_hue(colors: Tensor, turns: float) -> Tensor:
    """Colors whose hue is shifted along the color circle; saturation and value stay, and so do grays.

    Hue is that of HSV (Smith, 1978, doi:10.1145/965139.807361), as PCFH takes it; a whole turn changes nothing.

    Args:
        colors: (P, 3) sRGB in [0, 1].
        turns: of the circle; a third takes red to green.

    Returns:
        (P, 3) in [0, 1]. Gradients flow.

    Raises:
        ValueError: another shape.

    Example:
        >>> shift_hue(torch.tensor([[1.0, 0.0, 0.0]]), 1 / 3).round(decimals=3).tolist()
        [[0.0, 1.0, 0.0]]
    """
    hue, saturation, value = hsv(colors).unbind(1)
    channel = colors.new_tensor([5.0, 3.0, 1.0])
    sector = torch.remainder(6 * (hue + turns)[:, None] + channel, 6.0)  # (P, 3)
    ramp = torch.minimum(sector, 4 - sector).clamp(0, 1)
    return value[:, None] * (1 - saturation[:, None] * ramp)
