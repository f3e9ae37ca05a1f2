"""The second step of FPFH and PCFH with gradients: histograms of neighbors, weighed by inverse squared distance.

The weighted sums over neighborhoods have gradients, of any order, that are sums of the same kind:

    S(table, w)[r] = sum_k w[r, k] table[index[r, k]]             neighbors gathered
    T(g, w)[p]     = sum_{r, k: index[r, k] = p} w[r, k] g[r]     rows spread to their neighbors
    D(g, table)[r, k] = g[r] . table[index[r, k]]

The gradients of S are T and D, those of T are S and D, those of D are S and T, so three functions are closed under
differentiation and nothing of size (P, K, D) is ever kept.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchreg.descriptors.histograms import weighted_sum
from torchreg.descriptors.soft.pairs import distinct
from torchreg.descriptors.soft.rows import Piece, PieceGradient, by_rows
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.compiled import fusible
from torchreg.geometry.numerics.derivatives import TensorFunction, transformed
from torchreg.types import Neighborhoods


def distance_weights(points: Tensor, near: Neighborhoods, neighbor_weights: Tensor | None) -> Tensor:
    """The weights (P, K): 1/d^2, relative to the nearest other point of the row, times the neighbor weights.

    Distances are measured again from the points, so that gradients reach them; the scale of a row cancels where its
    sum is scaled to 100. Points in one place weigh nothing.
    """
    return by_rows(_inverse_squares, points, near, neighbor_weights, derivative=_inverse_squares_gradient)


def _inverse_squares(piece: Piece) -> Tensor:
    return _ratio(piece.query, piece.neighbor, piece.votes)[0]


def _inverse_squares_gradient(piece: Piece, grad: Tensor) -> PieceGradient:
    weights, ratio, apart = _ratio(piece.query, piece.neighbor, piece.votes)
    of_square = grad * weights / apart * -2
    line = tuple((b - a) * of_square for a, b in zip(piece.query, piece.neighbor, strict=True))
    return PieceGradient(tuple(-part.sum(dim=1) for part in line), line, grad * ratio)


@fusible
def _ratio(query: tuple[Tensor, ...], neighbor: tuple[Tensor, ...], votes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weights (r, K), the same before votes were multiplied in, and squared distances (1 where nothing counts)."""
    dx, dy, dz = neighbor[0] - query[0], neighbor[1] - query[1], neighbor[2] - query[2]
    square = dx * dx + dy * dy + dz * dz
    counted = (distinct(square) & (votes.detach() != 0)).to(square.dtype)
    apart = square + (1 - counted)
    largest = torch.finfo(square.dtype).max
    nearest = apart.detach().masked_fill(counted == 0, largest).amin(dim=1, keepdim=True)
    ratio = nearest * counted / apart
    return ratio * votes, ratio, apart


def add_neighbors(
    histograms: Tensor, near: Neighborhoods, weights: Tensor, blocks: int, *, keep_own: bool = True
) -> Tensor:
    """Eq. (2) and (4) with gradients: the neighbors' histograms, scaled to 100 a block, plus a point's own.

    ``histograms`` (P, blocks x bins) are in percent, ``weights`` (P, K) those of ``distance_weights``; without
    ``keep_own`` the histograms of the neighbors alone are returned. Gradients flow to histograms and weights.
    """
    rows = neighbor_sum(histograms, near.index, weights).view(histograms.shape[0], blocks, -1)
    spread = scaled_to_100(rows).view(histograms.shape)
    return spread + histograms if keep_own else spread


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


def neighbor_sum(table: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    """S: (R, D) of a table (P, D), an index (R, K) and weights (R, K). Gradients of any order flow to both."""
    if transformed(table) or transformed(weights):
        return (table[index] * weights[..., None]).sum(dim=1)
    return _Sum.call(table, index, weights)


class _Sum(TensorFunction):
    @staticmethod
    def forward(ctx: Any, table: Tensor, index: Tensor, weights: Tensor) -> Tensor:  # noqa: ANN401
        ctx.save_for_backward(table, index, weights)
        return weighted_sum(table, index, weights)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, None, Tensor | None]:  # noqa: ANN401
        (table, index, weights), (grad,) = ctx.saved_tensors, grads
        of_table = _Spread.call(grad, index, weights, len(table)) if ctx.needs_input_grad[0] else None
        return of_table, None, _Dots.call(grad, index, table) if ctx.needs_input_grad[2] else None


class _Spread(TensorFunction):
    @staticmethod
    def forward(ctx: Any, rows: Tensor, index: Tensor, weights: Tensor, size: int) -> Tensor:  # noqa: ANN401
        ctx.save_for_backward(rows, index, weights)
        flat = index.reshape(-1)
        order = torch.argsort(flat.to(torch.int32) if size < 2**31 else flat, stable=True)
        slots = weights.reshape(-1)[order]
        return weighted_sum_of_runs(rows, order.div_(max(1, index.shape[1]), rounding_mode="floor"), flat, slots, size)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, None, Tensor | None, None]:  # noqa: ANN401
        (rows, index, weights), (grad,) = ctx.saved_tensors, grads
        of_rows = _Sum.call(grad, index, weights) if ctx.needs_input_grad[0] else None
        return of_rows, None, _Dots.call(rows, index, grad) if ctx.needs_input_grad[2] else None, None


def weighted_sum_of_runs(rows: Tensor, source: Tensor, flat: Tensor, slots: Tensor, size: int) -> Tensor:
    """(size, D): for every point p the sum of slots[j] rows[source[j]] over its run j of slots, in their order."""
    ends = torch.bincount(flat, minlength=size).cumsum(0)
    begins = torch.nn.functional.pad(ends, (1, 0))[:-1]
    return torch.nn.functional.embedding_bag(source, rows, begins, per_sample_weights=slots, mode="sum")


class _Dots(TensorFunction):
    @staticmethod
    def forward(ctx: Any, rows: Tensor, index: Tensor, table: Tensor) -> Tensor:  # noqa: ANN401
        ctx.save_for_backward(rows, index, table)
        count, width = index.shape
        out = rows.new_empty(count, width)
        for part in row_chunks(count, width * table.shape[1]):
            gathered = table.index_select(0, index[part].reshape(-1)).view(-1, width, table.shape[1])
            # no matrix product: its sums come in another order for a piece of one row
            torch.sum(gathered.mul_(rows[part, None]), dim=2, out=out[part])
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, None, Tensor | None]:  # noqa: ANN401
        (rows, index, table), (grad,) = ctx.saved_tensors, grads
        of_rows = _Sum.call(table, index, grad) if ctx.needs_input_grad[0] else None
        return of_rows, None, _Spread.call(rows, index, grad, len(table)) if ctx.needs_input_grad[2] else None
