"""Functions of a point and its neighbors, in pieces of rows that the backward pass computes again.

Plain autograd would keep every intermediate of every pair of neighbors, gigabytes for a cloud of 100,000 points. Here
the forward pass keeps the inputs alone, and the backward pass goes through the same pieces once more, so that memory
is that of one piece. Gradients of a point are summed in the order of the rows, whatever the pieces.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.histograms import neighbor_votes
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.derivatives import TensorFunction, derivative_wanted, transformed
from torchreg.geometry.numerics.gather import gather
from torchreg.geometry.numerics.sums import lane_sums
from torchreg.types import Neighborhoods


class Piece(NamedTuple):
    """Some rows of a neighborhood with everything that a kernel reads."""

    query: tuple[Tensor, ...]  # C columns (r, 1) of the points themselves
    neighbor: tuple[Tensor, ...]  # C columns (r, K) of their neighbors
    votes: Tensor  # (r, K) 1 where a slot holds another point, times its neighbor weight; else 0
    settings: Tensor | None  # (r, E) numbers that rows share, such as edges of bins; or ``None``


class PieceGradient(NamedTuple):
    """The gradient with respect to a piece, from a kernel's derivative by hand; ``None`` where it is not wanted."""

    query: tuple[Tensor, ...]  # C columns (r,)
    neighbor: tuple[Tensor, ...]  # C columns (r, K)
    votes: Tensor | None  # (r, K)


Kernel = Callable[[Piece], Tensor]
"""Rows (r, D) of a piece, by differentiable operations that do not mix rows."""

Derivative = Callable[[Piece, Tensor], PieceGradient]
"""From a piece and the gradient (r, D) of its rows to that of the piece without settings: faster than autograd."""


def by_rows(
    kernel: Kernel,
    table: Tensor,
    near: Neighborhoods,
    weights: Tensor | None = None,
    settings: Tensor | None = None,
    *,
    derivative: Derivative | None = None,
    width: int | None = None,
) -> Tensor:
    """Rows (P, D) of a kernel over P neighborhoods of a ``table`` (P, C), a piece at a time.

    ``width`` is how many numbers of a row the kernel works on at a time, by default the slots of a neighborhood.
    Neighbor ``weights`` (P, K) multiply the votes, and every row is handed the ``settings`` (E,). Gradients flow to all
    three, of any order (second ones through plain autograd, which keeps all intermediates); the first by
    ``derivative``, but by autograd where that is ``None`` or there are settings. The same bits for any pieces and
    number of threads.
    """
    if settings is not None:
        rows = table.shape[0]
        settings = settings.expand(rows, -1) if transformed(settings) else _Repeated.call(settings, rows)
    inputs = (table, weights, settings)
    given = [value for value in inputs if value is not None]
    if not derivative_wanted(*given) or any(map(transformed, given)):
        return _whole(kernel, near, width, *inputs)
    return _ByRows.call(kernel, derivative if settings is None else None, near, width, *inputs)


def _cuts(near: Neighborhoods, width: int | None) -> Iterator[slice]:
    return row_chunks(near.index.shape[0], near.max_neighbors if width is None else width)


def _pieces(
    near: Neighborhoods, width: int | None, table: Tensor, weights: Tensor | None, settings: Tensor | None
) -> Iterator[Piece]:
    columns = [column.contiguous() for column in table.unbind(1)]
    for rows in _cuts(near, width):
        index = near.index[rows]
        yield Piece(
            tuple(column[rows, None] for column in columns),
            tuple(gather(column, index) for column in columns),
            _votes(near, rows, table, None if weights is None else weights[rows]),
            None if settings is None else settings[rows],
        )


def _votes(near: Neighborhoods, rows: slice, table: Tensor, weights: Tensor | None) -> Tensor:
    counted = neighbor_votes(near.index, near.valid, rows)
    return counted.to(table.dtype) if weights is None else torch.where(counted, weights, 0)


def _whole(
    kernel: Kernel,
    near: Neighborhoods,
    width: int | None,
    table: Tensor,
    weights: Tensor | None,
    settings: Tensor | None,
) -> Tensor:
    """The kernel by plain autograd."""
    return torch.cat([kernel(piece) for piece in _pieces(near, width, table, weights, settings)] or [table[:, :0]])


class _ByRows(TensorFunction):
    @staticmethod
    def forward(
        ctx: Any,  # noqa: ANN401
        kernel: Kernel,
        derivative: Derivative | None,
        near: Neighborhoods,
        width: int | None,
        table: Tensor,
        weights: Tensor | None,
        settings: Tensor | None,
    ) -> Tensor:
        ctx.kernel, ctx.derivative, ctx.near, ctx.width = kernel, derivative, near, width
        ctx.save_for_backward(table, weights, settings)
        return _whole(kernel, near, width, table, weights, settings)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        inputs, wanted = ctx.saved_tensors, ctx.needs_input_grad[4:]
        if torch.is_grad_enabled():  # a second derivative is wanted
            out = _whole(ctx.kernel, ctx.near, ctx.width, *inputs)
            asked = [value for value, needed in zip(inputs, wanted, strict=True) if needed]
            gradients = iter(torch.autograd.grad(out, asked, grads[0], create_graph=True))
            return None, None, None, None, *(next(gradients) if needed else None for needed in wanted)
        return None, None, None, None, *_backward_by_pieces(ctx, inputs, wanted, grads[0])


def _backward_by_pieces(
    ctx: Any,  # noqa: ANN401
    inputs: tuple[Tensor, Tensor | None, Tensor | None],
    wanted: tuple[bool, bool, bool],
    grad: Tensor,
) -> tuple[Tensor | None, Tensor | None, Tensor | None]:
    table, weights, settings = inputs
    queries, neighbors = (table.new_zeros(table.shape[1], len(table)) for _ in range(2))
    of_weights = torch.empty_like(weights) if wanted[1] and weights is not None else None
    of_settings = settings.new_empty(settings.shape) if wanted[2] and settings is not None else None
    cuts, pieces = _cuts(ctx.near, ctx.width), _pieces(ctx.near, ctx.width, *inputs)
    for rows, piece in zip(cuts, pieces, strict=True):
        if ctx.derivative is not None:
            of_piece, shared = ctx.derivative(piece, grad[rows]), None
        else:
            of_piece, shared = _by_autograd(ctx.kernel, piece, wanted, grad[rows])
        if of_settings is not None and shared is not None:
            of_settings[rows] = shared
        if of_weights is not None and of_piece.votes is not None:
            of_weights[rows] = of_piece.votes * neighbor_votes(ctx.near.index, ctx.near.valid, rows)
        if wanted[0]:
            index = ctx.near.index[rows].reshape(-1)
            for c in range(len(neighbors)):
                queries[c, rows] = of_piece.query[c]
                neighbors[c].index_add_(0, index, of_piece.neighbor[c].reshape(-1))
    return (queries.add_(neighbors).t() if wanted[0] else None), of_weights, of_settings


def _by_autograd(
    kernel: Kernel, piece: Piece, wanted: tuple[bool, bool, bool], grad: Tensor
) -> tuple[PieceGradient, Tensor | None]:
    """The gradient of a piece, and that of its settings (r, E)."""
    columns = [value.detach() for value in (*piece.query, *piece.neighbor)]
    votes = piece.votes.detach()
    shared = None if piece.settings is None else piece.settings.detach()
    asked = (columns if wanted[0] else []) + ([votes] if wanted[1] else [])
    asked = asked + ([shared] if wanted[2] and shared is not None else [])
    for leaf in asked:
        leaf.requires_grad_()
    half = len(piece.query)
    with torch.enable_grad():
        out = kernel(Piece(tuple(columns[:half]), tuple(columns[half:]), votes, shared))
    gradients = list(torch.autograd.grad(out, asked, grad, allow_unused=True, materialize_grads=True))
    of_settings = gradients.pop() if wanted[2] else None
    of_votes = gradients.pop() if wanted[1] else None
    queries = tuple(column[:, 0] for column in gradients[:half])
    return PieceGradient(queries, tuple(gradients[half:]), of_votes), of_settings


class _Repeated(TensorFunction):
    """Numbers (E,) repeated in every row (P, E), whose gradient is summed in one fixed order."""

    @staticmethod
    def forward(ctx: Any, numbers: Tensor, rows: int) -> Tensor:  # noqa: ANN401
        return numbers.expand(rows, -1)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:  # noqa: ANN401
        return lane_sums(grads[0], dim=0), None
