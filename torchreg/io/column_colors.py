"""Colors among named columns: three channels, or all of them packed in one word; what is unusable becomes a note."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

CHANNELS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
PACKED_COLORS = ("rgb", "rgba")  # one word 0x_RRGGBB, of PCD; often declared as a float
_PLAIN, _OPAQUE, _END = 1 << 24, 0xFF000000, 1 << 32  # numbers of colors: without alpha below the first, or opaque
_NO_COLORS = "read without colors"


class ColumnColors(NamedTuple):
    """Colors (N, 3) of any real dtype and range, or ``None``, and what a user should know."""

    values: NDArray[Any] | None
    notes: tuple[str, ...] = ()


def colors_of(columns: dict[str, NDArray[Any]]) -> ColumnColors:
    """Pick the colors of columns (N,) by the names that files use; they never cost the points."""
    for names in CHANNELS:
        if all(name in columns for name in names):
            return _channels(columns, names)
    for name in PACKED_COLORS:
        if name in columns:
            return _unpacked(columns[name], name)
    return ColumnColors(None, _misspelled(columns))


def are_numbers(values: NDArray[Any]) -> bool:
    """Whether packed colors stored as floats (N,) are the numbers 0xRRGGBB, not floats of the same bits.

    Whole numbers from 1 to below 2^24 are never the bits of packed colors: alpha would be from 63 to 75. Nor are those
    of opaque colors: as bits, all would have alpha 79 and red 127.
    """
    some = values[np.isfinite(values) & (values != 0)]
    in_range = ((some >= 1) & (some < _PLAIN)) | ((some >= _OPAQUE) & (some < _END))
    return len(some) > 0 and bool((in_range & (some == np.floor(some))).all())


def _channels(columns: dict[str, NDArray[Any]], names: tuple[str, ...]) -> ColumnColors:
    kinds = [columns[name].dtype.name for name in names]
    if len(set(kinds)) > 1:
        return ColumnColors(None, (f"{_NO_COLORS}: {', '.join(names)} are of several types, {', '.join(kinds)}",))
    return ColumnColors(np.stack([columns[name] for name in names], axis=1))  # (N, 3)


def _unpacked(packed: NDArray[Any], name: str) -> ColumnColors:
    """Three bytes of every word; a float of four bytes stands for its bits, a longer one for its value."""
    notes: tuple[str, ...] = ()
    if packed.dtype.itemsize < 4:
        return ColumnColors(None, (f"{_NO_COLORS}: {name} needs four bytes, it has {packed.dtype.itemsize}",))
    if packed.dtype == np.float32 and not are_numbers(packed):
        packed = packed.view(np.uint32)
    elif packed.dtype.kind == "f":
        notes = (f"{name} holds whole numbers: they were read as 0xRRGGBB",)
        packed = np.where(np.isfinite(packed), packed, 0)
    fits = (packed >= -(2**31)) & (packed < _END) & (packed == np.floor(packed))
    if not fits.all():
        return ColumnColors(None, (f"{_NO_COLORS}: {name} holds {packed[np.argmin(fits)]:g}, no color of four bytes",))
    bits = packed.astype(np.int64) if packed.dtype.kind != "u" else packed
    return ColumnColors(np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=1).astype(np.uint8), notes)


def _misspelled(columns: dict[str, NDArray[Any]]) -> tuple[str, ...]:
    """A note where two of three channels are there."""
    for names in CHANNELS:
        missing = [name for name in names if name not in columns]
        if len(missing) == 1:
            there = " and ".join(name for name in names if name in columns)
            return (f"{_NO_COLORS}: there are {there} but no {missing[0]}",)
    return ()
