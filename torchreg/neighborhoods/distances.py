"""Squared distances, d^2 = dx dx + dy dy + dz dz, and the order of a row: ascending by (d^2, index).

Only IEEE additions and products of single elements, in this order: no matrix product, no fused
multiply-add. So every backend, device, chunk and number of threads gets the same bits.
"""

from __future__ import annotations

import torch
from torch import Tensor


def squared_distances(axes: Tensor, rows: Tensor, candidates: Tensor) -> Tensor:
    """The squared distances (R, K) of every row's point to its candidates.

    ``axes`` are (3, P), each coordinate contiguous: gathering numbers is faster than gathering points. ``rows`` (R,)
    and ``candidates`` (R, K) are integers.
    """
    differences = [
        axis.index_select(0, candidates.reshape(-1)).view(candidates.shape) - axis.index_select(0, rows)[:, None]
        for axis in axes.unbind(0)
    ]
    return sum_of_squares(*differences)


def sum_of_squares(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """(x x + y y) + z z of tensors of one shape. Overwrites them: allocating a result costs more than the sum."""
    return x.mul_(x).add_(y.mul_(y)).add_(z.mul_(z))


def sort_rows(sq_distance: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
    """Order every row ascending by (squared distance, index); both are (R, K)."""
    index, by_index = index.sort(dim=1)
    sq_distance, by_distance = sq_distance.gather(1, by_index).sort(dim=1, stable=True)
    return sq_distance, index.gather(1, by_distance)


def expect_searchable(points: Tensor, name: str) -> None:
    """Raise ``ValueError`` with the number of points that have no finite distance to all others.

    That is so for NaN, for infinities, and for coordinates so large that their squares overflow.
    """
    largest = (torch.finfo(points.dtype).max / 16) ** 0.5  # d^2 <= 3 (2 largest)^2 stays finite
    broken = int((~(points.abs() <= largest)).any(dim=1).sum())
    if broken:
        raise ValueError(f"{name}: expected finite coordinates up to {largest:.0e}, got {broken} points without")
