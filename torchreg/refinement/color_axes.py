"""Colors as coordinates in which the nearest points can be searched beside x, y, z.

Both maps are made of + - * / and roots by Newton's iteration, since powers and angles round by the place of an entry
in its tensor (``numerics.chunks``), and a correspondence must not depend on that.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.numerics.roots import square_root
from torchreg.types import Clouds

_TO_XYZ = (  # of linear sRGB, IEC 61966-2-1, divided by the white point D65
    (0.4124564 / 0.95047, 0.3575761 / 0.95047, 0.1804375 / 0.95047),
    (0.2126729, 0.7151522, 0.0721750),
    (0.0193339 / 1.08883, 0.1191920 / 1.08883, 0.9503041 / 1.08883),
)
_LINEAR = 0.04045  # up to which sRGB is linear
_CUBE = (6 / 29) ** 3  # down to which lightness follows a cube root
_GRAY = 1 / 255  # chroma up to which a color counts as gray
_ROUNDS = 16  # of Newton's iteration: enough for roots of [0.002, 1] from 1 to the last digits


def lab(clouds: Clouds) -> Tensor:
    """L, a, b of CIELAB (D65), each divided by 100: (P, 3) float64 of sRGB colors, which are clamped to [0, 1].

    Two colors are as far apart as the eye finds them, black and white by 1.
    """
    colors = _colors(clouds)
    above = colors > _LINEAR
    base = torch.where(above, (colors + 0.055) / 1.055, 1.0)
    linear = torch.where(above, base * base * _root(base * base, 5), colors / 12.92)  # base^2.4
    red, green, blue = linear.unbind(1)
    x, y, z = (_lightness(of_red * red + of_green * green + of_blue * blue) for of_red, of_green, of_blue in _TO_XYZ)
    return torch.stack([1.16 * y - 0.16, 5.0 * (x - y), 2.0 * (y - z)], dim=1)


def hue_circle(clouds: Clouds) -> Tensor:
    """Hue as a point on a circle of diameter 1: (P, 2) float64 of sRGB colors, which are clamped to [0, 1].

    So hues of 0.99 and 0.01 are neighbors, and opposite ones lie 1 apart. Gray has no hue, and lies in the middle. The
    angle is that in the plane across the gray axis of RGB, within 1.2 degrees of the hue of HSV.
    """
    red, green, blue = _colors(clouds).unbind(1)
    across = torch.stack([red - 0.5 * (green + blue), (0.75**0.5) * (green - blue)], dim=1)
    chroma = square_root(across[:, 0] * across[:, 0] + across[:, 1] * across[:, 1])[:, None]
    return torch.where(chroma > _GRAY, 0.5 * across / chroma.clamp(min=_GRAY), 0.0)


def _colors(clouds: Clouds) -> Tensor:
    if clouds.colors is None:
        raise ValueError("cloud: expected colors, got none")
    return clouds.colors.double().clamp(0, 1)


def _lightness(value: Tensor) -> Tensor:
    """The function f of CIELAB."""
    above = value > _CUBE
    return torch.where(above, _root(torch.where(above, value, 1.0), 3), value * (29 / 6) ** 2 / 3 + 4 / 29)


def _root(value: Tensor, degree: int) -> Tensor:
    """The root of values in [0.002, 1], by Newton's iteration from 1."""
    root = torch.ones_like(value)
    for _ in range(_ROUNDS):
        power = root
        for _ in range(degree - 2):
            power = power * root
        root = ((degree - 1) * root + value / power) / degree
    return root
