"""Weighted sums over neighborhoods whose gradients, of any order, are sums of the same kind.

    S(table, w)[r] = sum_k w[r, k] table[index[r, k]]       neighbors gathered
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
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.derivatives import TensorFunction, transformed


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
