"""From the colors that files hold to [0, 1]."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_SLACK = 1e-3  # a float color may exceed [0, 1] by this much and is cut off
_LEAST_BRIGHT = 16.0  # floats whose largest lies from here to 255 are 8-bit values


class ScaledColors(NamedTuple):
    """Colors and what they were.

    Attributes:
        values: (N, 3) float64 in [0, 1], or ``None`` where not one color is a number.
        depth: "uint8", "uint16" or "float".
        notes: what a user should know.
    """

    values: NDArray[Any] | None
    depth: str
    notes: tuple[str, ...]


def scale_colors(colors: NDArray[Any], name: str) -> ScaledColors:
    """Scale colors to [0, 1] by their dtype; by their largest value where the dtype does not tell.

    ========================  ==============================================================
    uint8                     / 255
    uint16                    / 65535
    other integers            / 255 up to 255, / 65535 up to 65535
    floats up to 1            as they are
    floats from 16 to 255     / 255 (the largest counts: averages of 8-bit colors)
    anything else             refused: negative values, floats with a maximum in (1, 16) or above 255
    ========================  ==============================================================

    A color with NaN or infinity becomes black, which has no hue.

    Args:
        colors: (N, 3) integers or floats.
        name: how the message calls them.

    Raises:
        ValueError: values out of these ranges.
    """
    if colors.dtype.kind in "iu":
        return _scale_integers(colors, name)
    finite = np.isfinite(colors).all(axis=1)  # (N,)
    if not finite.any():
        return ScaledColors(None, "float", ("not one color is a finite number: read without colors",))
    values = np.where(finite[:, None], colors, 0).astype(np.float64)
    low, high = float(values.min()), float(values.max())
    is_unit = high <= 1 + _SLACK
    is_byte = 255 >= high >= _LEAST_BRIGHT
    expected = f"float colors from 0 to 1, or to 255 with a maximum of at least {_LEAST_BRIGHT:g}"
    legal = low >= -_SLACK and (is_unit or is_byte)
    if not legal:
        raise ValueError(f"{name}: expected {expected}, got {low:g} to {high:g}")
    lost = len(finite) - int(finite.sum())
    notes = [f"{lost} colors are not finite and were made black"] * (lost > 0)
    if is_byte:
        notes.append(f"float colors up to {high:g} were taken for 8-bit values and divided by 255")
    return ScaledColors(np.clip(values / (255 if is_byte else 1), 0, 1), "float", tuple(notes))


def _scale_integers(colors: NDArray[Any], name: str) -> ScaledColors:
    low, high = int(colors.min()), int(colors.max())
    if low < 0 or high > 65535:
        raise ValueError(f"{name}: expected integer colors from 0 to 255 or 65535, got {low} to {high}")
    is_wide = colors.dtype == np.uint16 or high > 255
    notes: tuple[str, ...] = ()
    if is_wide and high <= 255:
        notes = (f"16-bit colors reach only {high} of 65535: very dark, unless they are 8-bit values",)
    return ScaledColors(colors / (65535.0 if is_wide else 255.0), "uint16" if is_wide else "uint8", notes)
