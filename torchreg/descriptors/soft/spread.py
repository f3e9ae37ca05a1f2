"""The second step of FPFH and PCFH with gradients: histograms of neighbors, weighed by inverse squared distance."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.descriptors.soft.pairs import distinct
from torchreg.descriptors.soft.rows import Piece, PieceGradient, by_rows
from torchreg.descriptors.soft.sums import neighbor_sum
from torchreg.geometry.numerics.compiled import fusible
from torchreg.types import Neighborhoods


def distance_weights(points: Tensor, near: Neighborhoods, neighbor_weights: Tensor | None) -> Tensor:
    """(P, K): 1/d^2, relative to the nearest other point of the row, times the neighbor weights.

    Distances are measured again from the points, so that gradients reach them; the scale of a row cancels where its
    sum is scaled to 100. Points in one place weigh nothing.
    """
    return by_rows(_inverse_squares, points, near, neighbor_weights, derivative=_inverse_squares_gradient)


def _inverse_squares(piece: Piece) -> Tensor:
    return _ratio(piece.own, piece.near, piece.votes)[0]


def _inverse_squares_gradient(piece: Piece, grad: Tensor) -> PieceGradient:
    weights, ratio, apart = _ratio(piece.own, piece.near, piece.votes)
    of_square = grad * weights / apart * -2
    line = tuple((b - a) * of_square for a, b in zip(piece.own, piece.near, strict=True))
    return PieceGradient(tuple(-part.sum(dim=1) for part in line), line, grad * ratio)


@fusible
def _ratio(own: tuple[Tensor, ...], near: tuple[Tensor, ...], votes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weights (r, K), the same before votes were multiplied in, and squared distances (1 where nothing counts)."""
    dx, dy, dz = near[0] - own[0], near[1] - own[1], near[2] - own[2]
    square = dx * dx + dy * dy + dz * dz
    counted = (distinct(square) & (votes.detach() != 0)).to(square.dtype)
    apart = square + (1 - counted)
    largest = torch.finfo(square.dtype).max
    nearest = apart.detach().masked_fill(counted == 0, largest).amin(dim=1, keepdim=True)
    ratio = nearest * counted / apart
    return ratio * votes, ratio, apart


def add_neighbors(own: Tensor, near: Neighborhoods, weights: Tensor, blocks: int, *, keep_own: bool = True) -> Tensor:
    """Eq. (2) and (4): the neighbors' histograms, scaled to 100 a block, plus a point's own.

    Args:
        own: (P, blocks x bins) in percent.
        near: P neighborhoods.
        weights: (P, K) from ``distance_weights``.
        blocks: how many histograms a row holds.
        keep_own: whether the own histogram is added.

    Returns:
        (P, blocks x bins). Gradients flow to ``own`` and ``weights``.
    """
    rows = neighbor_sum(own, near.index, weights).view(len(own), blocks, -1)
    spread = scaled_to_100(rows).view(own.shape)
    return spread + own if keep_own else spread


def scaled_to_100(histograms: Tensor) -> Tensor:
    """Histograms (..., bins) in percent; empty ones stay empty, without gradient."""
    total = histograms.sum(dim=-1, keepdim=True)
    # below it, a sum is what rounding left, or its reciprocal would not be finite
    filled = total.detach() > torch.finfo(histograms.dtype).tiny ** 0.5
    return torch.where(filled, histograms * (100 / torch.where(filled, total, 1)), 0)


def scaled_gradient(histograms: Tensor, grad: Tensor) -> Tensor:
    """From the gradient of ``scaled_to_100`` to that of the histograms, both (..., bins)."""
    total = histograms.sum(dim=-1, keepdim=True)
    filled = total > torch.finfo(histograms.dtype).tiny ** 0.5
    safe = torch.where(filled, total, 1)
    mean = (grad * histograms).sum(dim=-1, keepdim=True) / safe
    return torch.where(filled, (grad - mean) * (100 / safe), 0)
