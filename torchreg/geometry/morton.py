"""Order points along a Z curve (Morton, 1966), so that points close in space lie close in memory.

The code of a point interleaves the bits of its quantized coordinates: ... z1 y1 x1 z0 y0 x0.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect_shape
from torchreg.types.packing import checked_offsets, spans

BITS = 21  # per axis: three times 21 bits fill an int64 without its sign


def morton_order(points: Tensor, offsets: Tensor) -> Tensor:
    """Rows (P,) int64 that put ``points`` (P, 3) of any unit in Morton order; the clouds stay in place.

    ``offsets`` (B+1,) int64 are where the clouds begin and end. Every cloud is scaled by the longest edge of its
    bounding box, so its order does not depend on the batch. Points of equal code keep their order. No gradient flows.
    Raises ``ValueError`` at another shape or dtype.
    """
    expect_shape(points, "points", ("P", 3), "floating")
    order = torch.empty(points.shape[0], dtype=torch.int64, device=points.device)
    for begin, end in spans(checked_offsets(offsets, points.shape[0]), points.shape[0]):
        if end > begin:
            codes = _morton_codes(points[begin:end].detach())
            order[begin:end] = torch.argsort(codes, stable=True) + begin
    return order


def occupied_cells(points: Tensor) -> list[int]:
    """The numbers of cubes that hold points (N, 3), N > 0, when their bounding cube is halved 0, 1, ..., 21 times."""
    codes = _morton_codes(points.detach()).sort().values
    changed = codes[1:] ^ codes[:-1]  # its highest bit tells at which halving two neighbors part
    counts = [(changed >> (3 * (BITS - halvings)) != 0).sum() for halvings in range(BITS + 1)]
    return [1 + count for count in torch.stack(counts).tolist()]


def _morton_codes(points: Tensor) -> Tensor:
    """The code (N,) int64 of every point within the bounding cube of all of them."""
    points = points.double()
    low = points.amin(dim=0)
    extent = (points.amax(dim=0) - low).amax()
    extent = torch.where(extent > 0, extent, 1.0)
    cells = ((points - low) / extent * (2**BITS - 1)).long().clamp(0, 2**BITS - 1)  # (N, 3)
    x, y, z = _spread_bits(cells).unbind(dim=1)
    return x | (y << 1) | (z << 2)


def _spread_bits(value: Tensor) -> Tensor:
    """Move bit i of a 21-bit number to bit 3 i, halving the block that moves as one at each step."""
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        value = (value | (value << shift)) & mask
    return value
