r"""Optimal transport with a dustbin, by Sinkhorn's iterations on logarithms.

Every point has a mass of 1 to give to points of the other side or to a dustbin, which takes as much as the other side
has (Sarlin et al., SuperGlue, CVPR 2020, doi:10.1109/CVPR42600.2020.00499, section 3.2). With scores Z (N+1, M+1), the
dustbin's the last row and column, masses mu = (1, ..., 1, M) of rows and nu = (1, ..., 1, N) of columns (points that
take part counted), Sinkhorn and Knopp (Pacific J. Math. 21(2), 1967, doi:10.2140/pjm.1967.21.343) alternate

    u_i = log mu_i - log sum_j exp(Z_ij + v_j),     v_j = log nu_j - log sum_i exp(Z_ij + u_i),     C = exp(Z + u + v).

The derivative of the iterations, backward: with P_ij and Q_ij the two softmaxes above, a gradient g of v_j reaches Z_ij
as -P_ij g_j and u_i as their sum over j; likewise for u. So the way back needs u and v of every iteration, N + M
numbers each, and makes the softmaxes again: memory does not grow by N M per iteration, as it would in plain autograd.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchreg.errors import at_least
from torchreg.geometry.numerics.derivatives import TensorFunction, derivative_wanted, transformed
from torchreg.matching.softmax import one_number, score_masks


def sinkhorn(
    scores: Tensor,
    *,
    dustbin: float | Tensor = 1.0,
    iterations: int = 50,
    source_valid: Tensor | None = None,
    target_valid: Tensor | None = None,
) -> Tensor:
    """Confidences (..., N, M) from scores by optimal transport: every point has one partner or none.

    Scores and masks are those of ``dual_softmax``; so is ``dustbin``, divided by the temperature too, but it is not
    optional. The larger the differences of scores, the more iterations are needed. Confidences are not below 0, and
    zero in rows and columns that do not take part, whatever stands there (NaN too). Columns sum to 1 at most; rows do
    as the iterations settle. What is missing to 1 went to the dustbin. Gradients flow to scores and dustbin, those of
    the iterations done, of any order (second ones keep all intermediates), finite for equal and for huge scores and for
    empty sides. Raises ``ValueError`` where shapes or dtypes do not fit, or with ``iterations`` below 1.
    """
    masks = score_masks(scores, source_valid, target_valid)
    at_least(iterations, "iterations", 1)
    no_partner = one_number(dustbin, "dustbin", scores)
    lead = scores.shape[:-2]
    inner = torch.where(masks.pair, scores, 0)
    right = no_partner.expand(*lead, scores.shape[-2], 1)
    below = no_partner.expand(*lead, 1, scores.shape[-1] + 1)
    Z = torch.cat([torch.cat([inner, right], dim=-1), below], dim=-2)  # (..., N+1, M+1)
    log_mu, log_nu = _log_masses(masks.source, masks.target, Z), _log_masses(masks.target, masks.source, Z)
    if not derivative_wanted(Z) or transformed(Z):
        plan = _iterate(Z, log_mu, log_nu, iterations)
    else:
        plan = _Sinkhorn.call(Z, log_mu, log_nu, iterations)
    return plan[..., :-1, :-1]


def _log_masses(side: Tensor, other: Tensor, like: Tensor) -> Tensor:
    """(..., N+1): 0 for points that take part, -inf for others, and the number of the other side for the dustbin.

    That number is 1 at least: where it should be 0, so is every confidence, and no sum of exponentials is empty.
    """
    points = torch.zeros(side.shape, dtype=like.dtype, device=like.device).masked_fill(~side, -torch.inf)
    count = other.sum(dim=-1, keepdim=True).clamp(min=1).to(like.dtype)
    return torch.cat([points, count.log()], dim=-1)


def _iterate(Z: Tensor, log_mu: Tensor, log_nu: Tensor, iterations: int) -> Tensor:
    """The transport plan (..., N+1, M+1) by plain operations."""
    rows, columns = _steps(Z, log_mu, log_nu, iterations)
    return _plan(Z, log_mu - rows[-1], columns[-1], log_nu)


def _steps(Z: Tensor, log_mu: Tensor, log_nu: Tensor, iterations: int) -> tuple[list[Tensor], list[Tensor]]:
    """The logarithms of the sums over rows (..., N+1) and over columns (..., M+1) in every iteration."""
    v = _start(log_nu)
    rows, columns = [], []
    for _ in range(iterations):
        rows.append((Z + v[..., None, :]).logsumexp(dim=-1))
        columns.append((Z + (log_mu - rows[-1])[..., None]).logsumexp(dim=-2))
        v = log_nu - columns[-1]
    return rows, columns


def _start(log_nu: Tensor) -> Tensor:
    """v before the first iteration: 0 for columns that take part."""
    return torch.where(log_nu.isneginf(), log_nu, 0)


def _plan(Z: Tensor, u: Tensor, column: Tensor, log_nu: Tensor) -> Tensor:
    """exp(Z + u + v) with v = log nu - column, as a softmax times a mass, which no rounding takes above it."""
    return (Z + u[..., None] - column[..., None, :]).exp() * log_nu.exp()[..., None, :]


class _Sinkhorn(TensorFunction):
    @staticmethod
    def forward(ctx: Any, Z: Tensor, log_mu: Tensor, log_nu: Tensor, iterations: int) -> Tensor:  # noqa: ANN401
        rows, columns = _steps(Z, log_mu, log_nu, iterations)
        ctx.save_for_backward(Z, log_mu, log_nu, torch.stack(rows), torch.stack(columns))
        ctx.iterations = iterations
        return _plan(Z, log_mu - rows[-1], columns[-1], log_nu)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None, None]:  # noqa: ANN401
        Z, log_mu, log_nu, rows, columns = ctx.saved_tensors
        if torch.is_grad_enabled():  # a second derivative is wanted
            plan = _iterate(Z, log_mu, log_nu, ctx.iterations)
            return torch.autograd.grad(plan, Z, grads[0], create_graph=True)[0], None, None, None
        plan = _plan(Z, log_mu - rows[-1], columns[-1], log_nu)
        of_Z = grads[0] * plan
        of_u, of_v = of_Z.sum(dim=-1), of_Z.sum(dim=-2)
        for k in range(ctx.iterations - 1, -1, -1):
            by_column = (Z + (log_mu - rows[k])[..., None]).sub_(columns[k][..., None, :]).exp_()
            by_column.mul_(of_v[..., None, :])
            of_Z.sub_(by_column)
            of_u = of_u - by_column.sum(dim=-1)
            v = _start(log_nu) if k == 0 else log_nu - columns[k - 1]
            by_row = (Z + v[..., None, :]).sub_(rows[k][..., None]).exp_().mul_(of_u[..., None])
            of_Z.sub_(by_row)
            of_u, of_v = torch.zeros_like(of_u), -by_row.sum(dim=-2)
        return of_Z, None, None, None
