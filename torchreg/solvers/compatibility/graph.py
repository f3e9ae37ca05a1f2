"""Which correspondences agree with each other about length, and which share the partners that agree.

A rigid motion keeps lengths, so two inliers i, j have

    A_ij = 1  where  | |p_i - p_j| - |q_i - q_j| | <= threshold,  i != j

and many outliers have it by chance. With the squared lengths a and b, in units of the squared threshold, that is

    (a - b)^2 <= (sqrt a + sqrt b)^2,   or   u |u| <= 4 a b   for   u = (a - b)^2 - (a + b),

which needs no root: torch's differs in the last bit between processors and places in a tensor. The second order counts
common partners, A_ij (A A)_ij: two inliers share all other inliers, outliers only a few by chance (SC2-PCR: Chen, Sun,
Yang and Tao, CVPR 2022, doi:10.1109/CVPR52688.2022.01287, Eq. 4 to 6).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.native import KERNEL_TYPES, call, native

TILE_ELEMENTS = 1 << 18
"""Pairs that are compared at once: 1 MB of float32 each temporary."""


def agreeing(source: Tensor, target: Tensor, others: tuple[Tensor, Tensor], threshold: float, spare: Tensor) -> Tensor:
    """(R, C) zeros and ones: correspondences (3, R) twice against ``others``, (3, C) twice, elementwise.

    ``spare`` (3, R C or more) is memory to work in; the result is part of it.
    """
    a, b, between = (row[: source.shape[1] * others[0].shape[1]].view(source.shape[1], -1) for row in spare)
    per_square = 1 / (threshold * threshold)
    squares(source, others[0], a, between).mul_(per_square)
    squares(target, others[1], b, between).mul_(per_square)
    torch.sub(a, b, out=between)
    between.mul_(between).sub_(a + b)
    between.mul_(between.abs())
    agree: Tensor = between.le_(a.mul_(4).mul_(b))
    return agree


def squares(points: Tensor, others: Tensor, out: Tensor, between: Tensor) -> Tensor:
    """Squared distances (R, C) of points (3, R) and others (3, C), into ``out``; ``between`` is of the same shape."""
    torch.sub(points[0, :, None], others[0], out=between)
    torch.mul(between, between, out=out)
    for i in (1, 2):
        torch.sub(points[i, :, None], others[i], out=between)
        out.add_(between.mul_(between))  # addcmul_ would round once on some processors, and twice on others
    return out


def first_order(source: Tensor, target: Tensor, threshold: float) -> Tensor:
    """A (N, N) float32 of zeros and ones of correspondences (3, N) twice, the diagonal zero."""
    count = source.shape[1]
    if native(source, target) and source.dtype in KERNEL_TYPES:
        return _first_order_compiled(source, target, threshold)
    graph = torch.empty(count, count, dtype=torch.float32, device=source.device)
    spare = source.new_empty(3, min(count * count, max(count, TILE_ELEMENTS)))
    for rows in row_chunks(count, count, TILE_ELEMENTS):
        graph[rows] = agreeing(source[:, rows], target[:, rows], (source, target), threshold, spare)
    return graph.fill_diagonal_(0)


def _first_order_compiled(source: Tensor, target: Tensor, threshold: float) -> Tensor:
    """As ``first_order``."""
    count = source.shape[1]
    graph = torch.empty(count, count, dtype=torch.float32)
    sides = (source.contiguous(), target.contiguous())
    call(f"first_order_{KERNEL_TYPES[source.dtype]}", *sides, count, 1 / (threshold * threshold), graph)
    return graph


def second_order(graph: Tensor) -> Tensor:
    """Common partners of those that agree, (..., N, N) float32.

    Zeros and ones and their counts are whole numbers, so the product is exact in any order of addition.
    """
    return (graph @ graph).mul_(graph)
