"""Consensus sets: around every correspondence those that share the most partners with it, and their transform.

Two narrowings, as SC2-PCR has them: the nearest by second-order agreement over all nodes, then, counted inside the
set alone, those nearest again. The weights of the fit are the leading eigenvector of the set's second order, by a few
power iterations; started from ones and left unscaled, they are whole numbers below 2^53, exact in float64.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.best_rotation import best_rotation, best_translation
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.sums import lane_sums
from torchreg.native import call, native
from torchreg.solvers.compatibility.graph import second_order

_ITERATIONS = 4
_MIN_SINE = 0.05  # as of a minimal sample: spread across the main direction, of the spread along it
_PLACES = 1 << 12  # more than there are nodes; twice as many nodes' counts stay whole in float32

_EXACT = 98  # members of whose sets the weights stay below 2^53 in any case


def consensus_sets(graph: Tensor, wide: int, narrow: int) -> tuple[Tensor, Tensor]:
    """The sets of all nodes of a graph A (N, N) float32, N at most 4,095.

    A seed has ``wide`` partners in its first set, of which ``narrow`` members are left, the seed counted. Returns
    members (N, narrow') int64, the seed first, and weights (N, narrow') float64, zero for no member.
    """
    count = len(graph)
    narrow = min(narrow, min(wide, count - 1) + 1)
    if native(graph) and graph.dtype == torch.float32 and narrow <= _EXACT:
        return _sets_compiled(graph, min(wide, count - 1), narrow)
    shared = second_order(graph).fill_diagonal_(-1)  # no node is its own partner, not even for lack of others
    partners = _largest(shared, min(wide, count - 1))  # (N, wide)
    seeds = torch.arange(count, device=graph.device)
    members = torch.cat([seeds[:, None], partners], dim=1)  # (N, 1 + wide)
    inside = _subgraphs(graph, members)
    within = (inside[:, :1] @ inside)[:, 0] * inside[:, 0]  # the seed's row of the second order
    within[:, 0] = -1  # the seed stands first in any case
    nearest = _largest(within, narrow - 1)
    kept = torch.cat([torch.zeros_like(nearest[:, :1]), nearest], dim=1)  # (N, narrow)
    inside = inside.gather(1, kept[:, :, None].expand(-1, -1, inside.shape[2])).gather(
        2, kept[:, None].expand(-1, kept.shape[1], -1)
    )
    return members.gather(1, kept), _leading(second_order(inside).double())


def _sets_compiled(graph: Tensor, wide: int, narrow: int) -> tuple[Tensor, Tensor]:
    """As ``consensus_sets``, of a graph with more than ``wide`` nodes."""
    count = len(graph)
    members, weights = (torch.empty(count, narrow, dtype=dtype) for dtype in (torch.int64, torch.float64))
    call("consensus_sets", graph.contiguous(), count, wide, narrow, members, weights)
    return members, weights


def fit_sets(source: Tensor, target: Tensor, members: Tensor, weights: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weighted least squares of sets (S, K) of the points (3, N) float64, sums in the order of the members.

    Returns rotations (3, 3, S), translations (3, S), and which sets (S,) determine the rotation: spread across a line.
    """
    if native(source, target, members, weights):
        return _fits_compiled(source, target, members, weights)
    sets, size = members.shape
    none = [source.new_zeros(*shape, 0) for shape in ((3,), (3,), (3, 3))]
    parts = [
        _moments(source, target, members[rows].t(), weights[rows].t().contiguous())
        for rows in row_chunks(sets, 9 * size)
    ]
    none.append(weights.new_zeros(0, dtype=torch.bool))
    mean_p, mean_q, covariance, fixed = (torch.cat(part, dim=-1) for part in zip(none, *parts, strict=True))
    rotation = best_rotation(covariance)
    return rotation, best_translation(rotation, mean_p, mean_q), fixed


def _moments(source: Tensor, target: Tensor, members: Tensor, weights: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Of members and weights (K, S): means (3, S) twice, covariances (3, 3, S), and which spread across a line."""
    total = _total(weights)
    share = weights / torch.where(total > 0, total, torch.ones_like(total))  # (K, S)
    p, q = (side.index_select(1, members.flatten()).view(3, *members.shape) for side in (source, target))  # (3, K, S)
    mean_p, mean_q = _total(p * share), _total(q * share)  # (3, S)
    p, q = p - mean_p[:, None], q - mean_q[:, None]
    weighted = p * share
    covariance = _total(weighted[:, None] * q[None])  # (3, 3, S)
    broad = _spans_plane(_total(weighted[:, None] * p[None]))
    broad &= _spans_plane(_total((q * share)[:, None] * q[None]))
    return mean_p, mean_q, covariance, broad & (total > 0)


def _fits_compiled(source: Tensor, target: Tensor, members: Tensor, weights: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """As ``fit_sets``."""
    sets, size = members.shape
    rotation, translation = source.new_empty(3, 3, sets), source.new_empty(3, sets)
    broad = torch.empty(sets, dtype=torch.bool)
    points = (source.contiguous(), target.contiguous(), source.shape[1])
    of_sets = (members.contiguous(), weights.contiguous(), sets, size)
    call("fit_sets", *points, *of_sets, _MIN_SINE * _MIN_SINE, rotation, translation, broad)
    return rotation, translation, broad


def _total(values: Tensor) -> Tensor:
    """Sums (..., S) of values (..., K, S), one after another."""
    return lane_sums(values, 1, dim=-2)


def _largest(counts: Tensor, number: int) -> Tensor:
    """Columns of the ``number`` largest of every row, ties to the earlier one."""
    column = torch.arange(counts.shape[1], dtype=counts.dtype, device=counts.device)
    return (counts * _PLACES - column).topk(number, dim=1).indices


def _subgraphs(graph: Tensor, members: Tensor) -> Tensor:
    places = members[:, :, None] * len(graph) + members[:, None, :]  # (N, K, K)
    return graph.flatten().index_select(0, places.flatten()).view(places.shape)


def _leading(agreement: Tensor) -> Tensor:
    """Unscaled leading eigenvectors (N, K) of whole numbers (N, K, K); a row of zeros stays zero."""
    vector = agreement.sum(dim=2)
    for _ in range(_ITERATIONS - 1):
        vector = (agreement @ vector[..., None])[..., 0]
    return vector


def _spans_plane(covariance: Tensor) -> Tensor:
    """(S,) bool of covariances (3, 3, S): the second principal spread is not small beside the first."""
    xx, yy, zz = (covariance[i, i] for i in range(3))
    xy, xz, yz = covariance[0, 1], covariance[0, 2], covariance[1, 2]
    trace = xx + yy + zz
    minors = (xx * yy - xy * xy) + (xx * zz - xz * xz) + (yy * zz - yz * yz)  # the products of two spreads each
    return minors > _MIN_SINE * _MIN_SINE * trace * trace
