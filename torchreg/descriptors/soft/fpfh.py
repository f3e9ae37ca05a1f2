"""FPFH with gradients: Eq. (2) of the paper over soft histograms of the three angles."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.descriptors.pair_features import ANGLE_BINS, Oriented
from torchreg.descriptors.soft.pairs import arranged_pair, pair_gradient, pair_positions
from torchreg.descriptors.soft.rows import Piece, PieceGradient, by_rows
from torchreg.descriptors.soft.spread import add_neighbors, distance_weights, scaled_gradient, scaled_to_100
from torchreg.descriptors.soft.votes import Shares, bin_shares, share_gradient, shared_votes
from torchreg.geometry.numerics.compiled import fusible
from torchreg.types import Neighborhoods

_ANGLES = 3


def soft_fpfh(
    points: Tensor,
    normals: Tensor,
    near: Neighborhoods,
    *,
    keep_own: bool,
    bandwidth: float,
    edges: Tensor | None,
    neighbor_weights: Tensor | None,
) -> Tensor:
    """(P, 33); the arguments are those of ``torchreg.fpfh``, ``keep_own`` whether SPFH(q) is added."""

    def histograms(piece: Piece) -> Tensor:
        shares = _shares(piece.query, piece.neighbor, _edges(piece), bandwidth)
        return scaled_to_100(_counts(shares, piece.votes)).flatten(1)

    def derivative(piece: Piece, grad: Tensor) -> PieceGradient:
        shares = _shares(piece.query, piece.neighbor, _edges(piece), bandwidth)
        counts = _counts(shares, piece.votes)
        of_counts = scaled_gradient(counts, grad.view(counts.shape))
        return PieceGradient(*_gradient(piece.query, piece.neighbor, piece.votes, shares, of_counts, bandwidth))

    if points.shape[0] == 0:
        return points.new_empty(0, _ANGLES * ANGLE_BINS)
    settings = None if edges is None else edges.flatten()
    table = torch.cat([points, normals], dim=1)
    spfh = by_rows(histograms, table, near, neighbor_weights, settings, derivative=derivative)
    weights = distance_weights(points, near, neighbor_weights)
    return add_neighbors(spfh, near, weights, _ANGLES, keep_own=keep_own)


@fusible
def _shares(
    query: tuple[Tensor, ...], neighbor: tuple[Tensor, ...], edges: list[Tensor | None], bandwidth: float
) -> list[Shares]:
    """The bins between which the three angles of every pair lie."""
    positions = pair_positions(arranged_pair(Oriented(*query), Oriented(*neighbor)))
    return [
        bin_shares(position, ANGLE_BINS, bandwidth, edges=edges[angle], circular=angle == 0)
        for angle, position in enumerate(positions)
    ]


def _counts(shares: list[Shares], votes: Tensor) -> Tensor:
    """(r, 3, 11)."""
    return torch.stack([shared_votes(share, votes, ANGLE_BINS) for share in shares], dim=1)


@fusible
def _gradient(
    query: tuple[Tensor, ...],
    neighbor: tuple[Tensor, ...],
    votes: Tensor,
    shares: list[Shares],
    of_counts: Tensor,
    bandwidth: float,
) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...], Tensor]:
    """From the gradient (r, 3, 11) of counts to that of points and normals, of query and neighbor, and of votes."""
    parts = [share_gradient(share, of_counts[:, i], bandwidth) for i, share in enumerate(shares)]
    of_f1, of_f2, of_f3 = (
        part.step * votes * (ANGLE_BINS / reach) for part, reach in zip(parts, (2 * math.pi, 2, 2), strict=True)
    )
    of_pair = pair_gradient(arranged_pair(Oriented(*query), Oriented(*neighbor)), of_f1, of_f2, of_f3)
    of_query = (*(-part.sum(dim=1) for part in of_pair.line), *(part.sum(dim=1) for part in of_pair.query_normal))
    of_votes = parts[0].level + parts[1].level + parts[2].level
    return of_query, (*of_pair.line, *of_pair.neighbor_normal), of_votes


def _edges(piece: Piece) -> list[Tensor | None]:
    """The edges (r, bins + 1) of every angle."""
    if piece.settings is None:
        return [None] * _ANGLES
    return list(piece.settings.view(piece.settings.shape[0], _ANGLES, -1).unbind(1))
