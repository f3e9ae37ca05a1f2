"""Squared distances of many rows at once, as a matrix product, and how far rounding can take it.

    |a - b|^2 = |a - c|^2 + |b - c|^2 - 2 (a - c).(b - c)

for any c. Rounding grows with (|a - c| + |b - c|)^2 (Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed.
2002, section 3.1), so c is put among the rows: their mean, or the median where most are nearly equal, as on walls.
A common power of two keeps squares from overflowing. Both leave the order of distances as it is.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

_GROUPS = 16  # of columns, in large tables
_LANES = 64  # float32 that PyTorch's least of rows takes at once, and what is left over singly: shows in small tables
_ONE_BY_ONE = 4  # so few least entries
_NARROW = 256  # of so few are found faster one after another than by ``topk``


class Product(NamedTuple):
    """Factors of the matrix of squared distances, in units of ``scale`` squared."""

    left: Tensor  # (N, D + 2) factor of the queries
    right: Tensor  # (D + 2, M') factor of the table; columns from M on are infinitely far from everything
    left_norm: Tensor  # (N,) float64, length of the centered queries
    right_norm: Tensor  # (M,) float64, length of the centered rows of the table
    scale: Tensor  # () float64, a power of two
    width: int  # members of a group of columns are so far apart; a divisor of M'

    def error(self, norm: Tensor, distance: Tensor) -> Tensor:
        """Largest error of entries whose true distance is at most ``distance`` (...), scaled; (...) float64.

        ``norm`` (...) are the lengths of the rows (or columns) at hand: a row no farther than d from one of length n
        is no longer than n + d. Covers the errors of the product, of its factors and of the float64 distances that
        decide.
        """
        return self._unit() * (2 * norm + distance).square() + self._tiny()

    def reach(self, norm: Tensor, value: Tensor, longest: Tensor) -> Tensor:
        """Greatest true distance (...) that entries ``value`` (...) can stand for, scaled; float64.

        ``longest`` () is the greatest length on the other side.
        """
        return (value.double().clamp(min=0) + self._unit() * (norm + longest).square() + self._tiny()).sqrt()

    def _unit(self) -> float:
        unit = torch.finfo(self.left.dtype).eps / 2 + torch.finfo(torch.float64).eps / 2
        return (self.left.shape[1] + 8) * unit

    def _tiny(self) -> float:
        return self.left.shape[1] * torch.finfo(self.left.dtype).tiny


def product(query: Tensor, table: Tensor, center: Tensor, dtype: torch.dtype) -> Product:
    """Factors in ``dtype`` for rows ``query`` (N, D) against ``table`` (M, D); N, M >= 1, finite.

    ``center`` (D,) float64 is best where the rows lie that are hardest to tell apart.
    """
    left, right = query.double() - center, table.double() - center
    exponent = torch.frexp(torch.maximum(left.abs().amax(), right.abs().amax())).exponent
    scale = torch.full_like(center[0], 2) ** exponent
    left, right = (left / scale).to(dtype), (right / scale).to(dtype)
    a, b = left.double().square().sum(dim=1), right.double().square().sum(dim=1)
    width = _LANES if len(table) <= 2 * _GROUPS * _LANES else -(-len(table) // _GROUPS)
    padding = -len(table) % width
    columns = torch.cat([-2 * right, b[:, None].to(dtype), torch.ones_like(right[:, :1])], dim=1).t()  # (D + 2, M)
    columns = torch.nn.functional.pad(columns, (0, padding)).contiguous()  # (D + 2, M')
    columns[-2, len(table) :] = float("inf")
    rows = torch.cat([left, torch.ones_like(left[:, :1]), a[:, None].to(dtype)], dim=1)
    return Product(rows, columns, a.sqrt(), b.sqrt(), scale, width)


def least(tile: Tensor, width: int, count: int) -> tuple[Tensor, Tensor]:
    """The ``count`` least entries of every row of a tile (R, M') and their columns, (R, count) each, ascending.

    Columns ``width`` apart make a group. The least of every group come first, at the speed of the memory; the
    ``count`` least entries lie in the groups with the ``count`` least of those. So many of a row must be finite.
    """
    groups = tile.view(len(tile), -1, width).amin(dim=1)  # (R, width)
    _, place = _ascending(groups, min(count, width))
    member = torch.arange(0, tile.shape[1], width, device=tile.device)
    column = (place[:, :, None] + member).flatten(1)  # (R, count M' / width)
    value, order = _ascending(tile.gather(1, column), count)
    return value, column.gather(1, order)


def _ascending(values: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The ``count`` least of every row (R, C) and their columns; a few of them one by one, overwriting them."""
    if count > _ONE_BY_ONE or values.shape[1] > _NARROW:
        value, column = values.topk(count, largest=False)
        return value, column
    minima = []
    for _ in range(count):
        minima.append(values.min(dim=1, keepdim=True))
        values.scatter_(1, minima[-1].indices, float("inf"))
    return torch.cat([each.values for each in minima], dim=1), torch.cat([each.indices for each in minima], dim=1)
