"""CIELAB of sRGB colors (CIE 15:2004; IEC 61966-2-1), by operations that round alike everywhere.

Powers and cube roots of a vector library round otherwise at the end of a range than within it, so that a color's value
would depend on where in a batch it stands. Here both are roots by Newton's method, of a fixed number of steps.
"""

from __future__ import annotations

import torch
from torch import Tensor

# The matrix and the white point are D65's, with the digits that PCL uses.
_XYZ = ((0.412453, 0.357580, 0.180423), (0.212671, 0.715160, 0.072169), (0.019334, 0.119193, 0.950227))
_WHITE = (0.95047, 1.0, 1.08883)
_STEPS = 6  # from guesses good to 0.1: to the last bit of float64


def lab(colors: Tensor) -> Tensor:
    """L / 100, a / 120 and b / 120 (P, 3) of sRGB colors (P, 3) in [0, 1]: in [0, 1], [-1, 1] and [-1, 1].

    Gradients flow. The same bits in any batch.
    """
    red, green, blue = (_linear(channel) for channel in colors.unbind(1))
    fx, fy, fz = (
        _cube_root((row[0] * red + row[1] * green + row[2] * blue) / white)
        for row, white in zip(_XYZ, _WHITE, strict=True)
    )
    lightness = (1.16 * fy - 0.16).clamp(max=1)
    a, b = ((fx - fy) * (500 / 120)).clamp(-1, 1), ((fy - fz) * (200 / 120)).clamp(-1, 1)
    return torch.stack([lightness, a, b], dim=1)


def _linear(channel: Tensor) -> Tensor:
    """The light (P,) of a channel of sRGB in [0, 1]."""
    bright = channel > 0.04045
    base = torch.where(bright, (channel + 0.055) / 1.055, 1.0)
    root = 0.5 + 0.5 * base  # of the fifth power; in [0.09, 1] it is in [0.61, 1]
    for _ in range(_STEPS):
        root = (4 * root + base / (root * root * root * root)) * 0.2
    return torch.where(bright, base * base * root * root, channel / 12.92)


def _cube_root(part: Tensor) -> Tensor:
    """CIE's f (P,): the cube root of numbers in [0, 1], a line where they are small."""
    large = part > 0.008856
    base = torch.where(large, part, 1.0)
    root = 0.35 + 0.7 * base
    for _ in range(_STEPS):
        root = (2 * root + base / (root * root)) / 3
    return torch.where(large, root, 7.87 * part + 16 / 116)
