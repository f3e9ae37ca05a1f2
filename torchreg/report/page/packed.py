"""Points of a cloud as text for a page: 16 bits a coordinate by blocks, in Morton order, deflated, in base64.

Neighbors along a Z curve are neighbors in space, so the differences from one point to the next are small numbers, whose
high bytes are mostly the same: a million points with colors take some 8 MB of text instead of 12. viewer.js has the way
back:

    text -> bytes -> inflated -> planes of bytes; differences within blocks, modulo 2^16 or 2^8 -> sums

The planes of places are the low and the high bytes of x, then of y, then of z; those of colors are red, green and blue.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.geometry.morton import morton_order

BLOCK = 4096
"""Points of a block: one after another along the Z curve."""

_STEPS = 65535  # of a 16 bit number
_FINER = 4  # a block may be so many times finer than 16 bits of the whole cloud; finer takes more bytes for nothing


def packing_order(points: NDArray[Any]) -> NDArray[np.int64]:
    """The order (N,) in which points (N, 3) are packed."""
    order: NDArray[np.int64] = morton_order(
        torch.from_numpy(np.ascontiguousarray(points)), torch.tensor([0, len(points)])
    ).numpy()
    return order


def packed_places(points: NDArray[Any]) -> dict[str, object]:
    """Points (N, 3), finite, as the fields ``count``, ``blocks`` (low x, y, z and the step of each) and ``places``."""
    blocks, parts = [], []
    whole = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    for begin in range(0, len(points), BLOCK):
        part = points[begin : begin + BLOCK]
        low = part.min(axis=0)
        step = (max(float(np.ptp(part, axis=0).max()), whole / _FINER) or 1.0) / _STEPS
        blocks.append([*low.tolist(), step])
        parts.append(_differences(np.rint((part - low) / step).astype(np.uint16)))
    numbers = np.concatenate(parts) if parts else np.empty((0, 3), np.uint16)
    planes = [plane for axis in numbers.T for plane in (axis & 255, axis >> 8)]
    return {"count": len(points), "blocks": blocks, "places": _text(np.stack(planes).astype(np.uint8))}


def packed_bytes(values: NDArray[Any]) -> str:
    """Bytes (N, C) of the points, such as colors."""
    values = values.astype(np.uint8)
    parts = [_differences(values[begin : begin + BLOCK]) for begin in range(0, len(values), BLOCK)]
    return _text(np.concatenate(parts).T if parts else np.empty(0, np.uint8))


def _differences(values: NDArray[Any]) -> NDArray[Any]:
    """The first row and the step to each of the others, which wraps around."""
    steps: NDArray[Any] = np.concatenate((values[:1], values[1:] - values[:-1]))
    return steps


def _text(planes: NDArray[Any]) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(planes).tobytes(), 6)).decode()
